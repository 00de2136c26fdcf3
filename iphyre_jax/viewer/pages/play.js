"use strict";
// The play page: a game, plays side by side, and the scene editor, on one page.

const NOBODY = "Nobody has played this scene yet";
const byId = (id) => document.getElementById(id);

class PlayPage {
  constructor(start) {
    this.start = start;
    this.scenes = start.games.map((game) => game.scene);
    const redraw = () => [this.game, this.deck, this.editor].forEach((part) => part && (part.draw || part.show).call(part));
    this.look = new Look(start.themes, byId("look"), redraw);
    const theme = () => this.look.colours;
    this.game = new Game(new Stage(byId("board"), theme), { change: () => this.showState(), end: (end) => this.ended(end) });
    this.deck = new Deck(byId("deck"), theme);
    this.editor = new Editor(new Stage(byId("sketch"), theme), {
      change: (scene) => this.showScene(scene),
      check: (answer) => this.showCheck(answer),
    });
    byId("source").textContent = `Paper: ${start.source.source}. ${start.source.protocol}.`;
    this.fillGames();
    this.wire();
    window.addEventListener("resize", redraw);
  }

  fillGames() {
    const groups = new Map();
    this.start.games.forEach((game, i) => {
      if (!groups.has(game.split)) groups.set(game.split, make("optgroup", { label: game.split }));
      groups.get(game.split).append(make("option", { value: i, textContent: game.name }));
    });
    byId("game").replaceChildren(...groups.values());
  }

  wire() {
    const { game, editor } = this;
    const press = (button, act) => {
      button.onclick = (event) => {
        if (event.detail) button.blur(); // pressed by a pointer: the next space is the game's
        return this.attempt(act);
      };
    };
    const on = (id, act) => press(byId(id), act);
    byId("game").onchange = () => this.attempt(() => this.choose());
    on("previous", () => this.turn(-1));
    on("next", () => this.turn(1));
    on("start", () => (game.state === "over" ? this.prepare() : game.start()));
    on("finish", () => game.finish());
    on("again", async () => {
      this.standing = (await call("again", { scene: nameOrScene(this.scene) })).standing;
      await this.prepare();
    });
    on("compare-now", () => this.mode("compare"));
    for (const tab of document.querySelectorAll("[data-mode]")) press(tab, () => this.mode(tab.dataset.mode));
    const board = game.stage.canvas;
    board.onpointerdown = (event) => this.attempt(() => game.press(game.stage.pointOf(event)));
    board.onpointermove = (event) => event.pointerType === "mouse" && game.hover(game.stage.pointOf(event));
    board.onpointerleave = () => game.hover(null);
    byId("left").onchange = byId("right").onchange = () => this.attempt(() => this.loadDeck());

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
    on("copy", () => editor.open(this.scene));
    on("run", () => this.runScene());
    on("save", () => this.saveScene());
    byId("scene-name").onchange = (event) => editor.rename(event.target.value);
    byId("load").onchange = (event) => this.attempt(() => this.loadScene(event.target));
    const sketch = editor.stage.canvas;
    sketch.onpointerdown = (event) => {
      sketch.setPointerCapture(event.pointerId);
      editor.press(editor.stage.pointOf(event), event.altKey);
    };
    sketch.onpointermove = (event) => editor.move(editor.stage.pointOf(event), event.altKey);
    sketch.onpointerup = sketch.onpointercancel = () => editor.release();
    document.addEventListener("keydown", (event) => this.attempt(() => this.key(event)));
  }

  /** Do something, and show an error if it fails. */
  async attempt(act) {
    try {
      byId("error").hidden = true;
      await act();
    } catch (error) {
      byId("error").textContent = error.message;
      byId("error").hidden = false;
      byId("status").textContent = "";
    }
  }

  mode(name) {
    this.shown = name;
    for (const tab of document.querySelectorAll("[data-mode]")) {
      tab.setAttribute("aria-pressed", tab.dataset.mode === name);
    }
    for (const section of ["play", "compare", "edit"]) byId(section).hidden = section !== name;
    this.deck.clock.stop();
    this.game.away = name !== "play";
    if (byId("status").textContent === NOBODY) byId("status").textContent = "";
    if (name === "compare") return this.compare();
    if (name === "edit") return void (this.editor.past.length ? this.editor.draw() : this.editor.open(this.scene));
    return void this.game.draw();
  }

  turn(by) {
    const games = byId("game");
    games.selectedIndex = (games.selectedIndex + by + games.length) % games.length;
    return this.choose();
  }

  /** Take the chosen game. */
  async choose() {
    await this.take(this.scenes[Number(byId("game").value)]);
    if (this.shown === "compare") await this.compare();
  }

  /** Take a scene: the name of a game or the contents of a scene. */
  async take(wanted) {
    const turn = (this.turns = (this.turns || 0) + 1);
    byId("status").textContent = "Preparing the simulator. The first time takes a few seconds …";
    document.documentElement.dataset.ready = "";
    const answer = await call("game", { scene: wanted.known || wanted });
    if (turn !== this.turns) return;
    byId("status").textContent = "";
    this.scene = { ...answer.scene, known: typeof wanted === "string" ? wanted : undefined };
    this.untouched = answer.play;
    this.standing = answer.standing;
    this.answer = answer;
    await this.prepare();
    document.documentElement.dataset.ready = this.scene.name;
  }

  /** Prepare the next attempt. */
  async prepare() {
    byId("result").textContent = "";
    byId("name").textContent = this.scene.name;
    byId("compare-now").hidden = true;
    await this.game.ready(this.scene, this.untouched);
    this.showScores();
  }

  /** The game is over: let the server compute and save the score. */
  ended({ plan }) {
    return this.attempt(async () => {
      const scene = this.scene;
      if (!this.standing.left) return void (byId("result").textContent = "Not counted: all attempts are used");
      const answer = await call("attempt", { scene: nameOrScene(scene), plan });
      if (scene !== this.scene) return;
      this.standing = answer.standing;
      const { play } = answer;
      byId("result").textContent = `${play.solved ? "Solved" : "Not solved"}: ${points(play.reward)}`;
      byId("result").className = `big ${play.solved ? "solved" : "failed"}`;
      byId("result").dataset.plan = JSON.stringify(play.plan);
      byId("result").dataset.reward = play.reward;
      byId("compare-now").hidden = false;
      this.showScores();
    });
  }

  /** Show time and buttons. */
  showState() {
    const { game } = this;
    if (game.state === "empty") return;
    byId("time").textContent = seconds(game.shown / game.tape.fps);
    byId("start").textContent = game.state === "over" ? "Try again" : "Start";
    const used = game.state === "over" && !this.standing.left;
    byId("start").disabled = game.state === "running" || game.state === "waiting" || used;
    byId("finish").disabled = game.state !== "running";
  }

  showScores() {
    const { standing, answer } = this;
    const { figures, best } = answer;
    const rewards = standing.rewards.map(points).join(", ");
    const left = `${standing.left} of ${this.start.attempts} attempts left`;
    byId("standing").textContent = rewards ? `${left}; so far ${rewards}` : left;
    byId("again").hidden = standing.left > 0;
    this.showState();
    const rows = [["your best", standing.best, true]];
    if (figures.human !== undefined) rows.push(["people: mean of the best of five attempts (paper)", figures.human]);
    if (figures.oracle_split !== undefined) rows.push([`oracle: mean over ${figures.split} (paper)`, figures.oracle_split]);
    if (best) rows.push(["best known plan", best.reward]);
    byId("scores").replaceChildren(...rows.map(([who, value, own]) => row(who, value, own)));
    const agents = Object.entries(figures.agents || {});
    byId("agents").hidden = byId("source").hidden = !agents.length;
    byId("agents").querySelector("table").replaceChildren(...agents.map(([who, value]) => row(who, value)));
  }

  /** Plays of this scene: own attempts, the best known plan, agents. */
  async compare() {
    const scene = this.scene;
    const plays = await call("agents", { scene: nameOrScene(scene) });
    if (scene !== this.scene || this.shown !== "compare") return; // the user has chosen something else
    this.plays = plays;
    const label = (play) => `${play.agent} · ${points(play.reward)} · ${play.fps} steps/s`;
    const option = (play, i) => make("option", { value: i, textContent: label(play) });
    const mine = this.plays.findLastIndex((play) => play.own);
    const other = this.plays.findIndex((play) => !play.own);
    byId("left").replaceChildren(...this.plays.map(option));
    byId("right").replaceChildren(make("option", { value: "", textContent: "nobody" }), ...this.plays.map(option));
    byId("left").value = mine >= 0 ? mine : other;
    byId("right").value = mine >= 0 && other >= 0 ? other : "";
    if (!this.plays.length) byId("status").textContent = NOBODY;
    await this.loadDeck();
  }

  async loadDeck() {
    const chosen = [byId("left").value, byId("right").value].filter((value) => value !== "");
    const plays = chosen.map((value) => this.plays[Number(value)]);
    await this.deck.load(plays.map((play) => ({ title: play.agent, play, scene: this.scene })));
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

  showCheck({ problems, warnings, file }) {
    const items = (lines) => lines.map((textContent) => make("li", { textContent }));
    byId("verdict").textContent = file ? "The scene is valid" : "The scene is not valid yet";
    byId("problems").replaceChildren(...items(problems));
    byId("warnings").replaceChildren(...items(warnings));
    byId("run").disabled = byId("save").disabled = !file;
  }

  /** Play the scene in the editor. */
  async runScene() {
    await this.take(structuredClone(this.editor.scene));
    byId("game").selectedIndex = -1; // it is not in the list
    await this.mode("play");
  }

  saveScene() {
    const link = make("a", { download: `${this.editor.scene.name.replace(/[^\w-]+/g, "_").slice(0, 60) || "scene"}.json` });
    link.href = URL.createObjectURL(new Blob([this.editor.answer.file], { type: "application/json" }));
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  async loadScene(input) {
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

  key(event) {
    if (this.shown === "compare") return void this.deck.key(event);
    if (event.target.closest("select, input")) return undefined;
    if (this.shown === "play") {
      if (hasModifier(event)) return undefined;
      if (event.key === " " && this.game.state === "ready" && !event.target.closest("button")) {
        event.preventDefault();
        this.game.start();
      }
      // 1 to 6 remove the blocks in the order of the plan, for people who do not use a pointer.
      if (/^[1-6]$/.test(event.key) && this.game.state === "running") {
        return this.game.remove(this.game.blocks[Number(event.key) - 1]);
      }
      return undefined;
    }
    const { editor } = this;
    if ((event.ctrlKey || event.metaKey) && event.key === "z") editor.undo();
    else if ((event.ctrlKey || event.metaKey) && event.key === "y") editor.redo();
    else if (hasModifier(event)) return undefined;
    const tools = { v: "select", b: "bar", o: "ball", j: "joint", k: "spring", x: "delete" };
    const acts = {
      e: () => editor.mark("eli"),
      m: () => editor.mark("dynamic"),
      "[": () => editor.reshape(-5, 1),
      "]": () => editor.reshape(5, 1),
      Delete: () => editor.delete(),
      Backspace: () => editor.delete(),
    };
    if (event.ctrlKey || event.metaKey) return undefined;
    if (tools[event.key]) editor.use(tools[event.key]);
    else if (acts[event.key]) acts[event.key]();
    return undefined;
  }
}

/** A row of a table of scores. */
function row(who, value, own = false) {
  const shown = value === null ? "–" : points(value);
  return make("tr", { className: own ? "own" : "" }, make("td", { textContent: who }), make("td", { textContent: shown }));
}

(async () => {
  try {
    const page = new PlayPage(await call("start"));
    page.shown = "play";
    byId("keys").textContent = "Keys: space starts the game; 1 to 6 remove the blocks in order.";
    await page.attempt(() => page.choose());
  } catch (error) {
    byId("error").textContent = error.message;
    byId("error").hidden = false;
  }
})();
