"use strict";
// The part of the play page around the scene editor: its tools, lists, keys and files.

class Drawing {
  /** stage: draws the scene; the scene is in `editor`. */
  constructor(stage) {
    this.editor = new Editor(stage, {
      change: (scene) => this.showScene(scene),
      check: (answer) => this.showCheck(answer),
    });
  }

  /** on(id, act): let a button act; attempt(act): do something and show its error. */
  wire(on, attempt) {
    const { editor } = this;
    for (const tool of document.querySelectorAll("[data-tool]")) tool.onclick = () => editor.use(tool.dataset.tool);
    on("eli", () => editor.mark("eli"));
    on("dynamic", () => editor.mark("dynamic"));
    on("turn-left", () => editor.reshape(-5, 1));
    on("turn-right", () => editor.reshape(5, 1));
    on("longer", () => editor.reshape(0, 1.1));
    on("shorter", () => editor.reshape(0, 1 / 1.1));
    on("undo", () => editor.undo());
    on("redo", () => editor.redo());
    on("clear", () => editor.open(EMPTY_SCENE()));
    on("save", () => this.save());
    byId("scene-name").onchange = (event) => editor.rename(event.target.value);
    byId("load").onchange = (event) => attempt(() => this.load(event.target));
    const sketch = editor.stage.canvas;
    sketch.onpointerdown = (event) => {
      sketch.setPointerCapture(event.pointerId);
      editor.press(editor.stage.pointOf(event), event.altKey);
    };
    sketch.onpointermove = (event) => editor.move(editor.stage.pointOf(event), event.altKey);
    sketch.onpointerup = () => editor.release();
    sketch.onpointercancel = () => editor.cancel();
  }

  showScene(scene) {
    const { editor } = this;
    if (document.activeElement !== byId("scene-name")) byId("scene-name").value = scene.name;
    for (const tool of document.querySelectorAll("[data-tool]")) {
      tool.setAttribute("aria-pressed", tool.dataset.tool === editor.tool);
    }
    const bar = editor.selected !== null && editor.selected < scene.block.length ? editor.selected : null;
    for (const id of ["eli", "dynamic", "turn-left", "turn-right", "longer", "shorter"]) byId(id).disabled = bar === null;
    for (const id of ["eli", "dynamic"]) byId(id).setAttribute("aria-pressed", bar !== null && Boolean(scene[id][bar]));
    byId("undo").disabled = !editor.past.length;
    byId("redo").disabled = !editor.future.length;
  }

  showCheck({ state, problems, warnings }) {
    const items = (lines) => lines.map((textContent) => make("li", { textContent }));
    byId("verdict").textContent = VERDICTS[state];
    byId("problems").replaceChildren(...items(problems));
    byId("warnings").replaceChildren(...items(warnings));
    byId("run").disabled = byId("save").disabled = state === "invalid";
  }

  save() {
    const { scene } = this.editor;
    const link = make("a", { download: `${fileName(scene.name)}.json` });
    link.href = URL.createObjectURL(new Blob([sceneText(scene)], { type: "application/json" }));
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    this.editor.keep();
  }

  async load(input) {
    const file = input.files[0];
    input.value = "";
    if (!file) return;
    if (file.size > 50000) throw new Error(`${file.name}: expected a scene file of at most 50000 bytes`);
    let scene;
    try {
      scene = JSON.parse(await file.text());
    } catch (error) {
      throw new Error(`${file.name}: expected JSON: ${error.message}`);
    }
    const { problems } = await call("check", { scene });
    if (problems.length) throw new Error(`${file.name}: ${problems.join("; ")}`);
    this.editor.selected = null;
    this.editor.open(scene);
  }

  /** Return what a key does; undefined for the keys of the browser. */
  key(event) {
    const { editor } = this;
    if (event.ctrlKey || event.metaKey) return { z: () => editor.undo(), y: () => editor.redo() }[event.key];
    if (hasModifier(event)) return undefined;
    const tools = { v: "select", b: "bar", o: "ball", j: "joint", k: "spring", x: "delete" };
    const acts = {
      e: () => editor.mark("eli"),
      m: () => editor.mark("dynamic"),
      "[": () => editor.reshape(-5, 1),
      "]": () => editor.reshape(5, 1),
      Delete: () => editor.delete(),
      Backspace: () => editor.delete(),
    };
    return tools[event.key] ? () => editor.use(tools[event.key]) : acts[event.key];
  }
}

/** The name of a scene as that of a file: letters and digits of any script. */
function fileName(name) {
  const words = name.replace(/[^\p{L}\p{M}\p{N}_-]+/gu, "_").replace(/^_+|_+$/g, "");
  return [...words].slice(0, 60).join("") || "scene";
}
