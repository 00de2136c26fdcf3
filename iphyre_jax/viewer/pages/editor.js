"use strict";
// The scene editor: place, drag, turn, stretch, mark and connect objects. After every change the server checks whether
// the scene is valid.

const GRID_STEP = 5; // px, grid to which points snap unless alt is held
const HANDLE = 9; // px, radius of a handle

const EMPTY_SCENE = () => ({
  schema: "iphyre_jax/scene", version: 1, name: "my scene",
  block: [], ball: [], eli: [], dynamic: [], joint: [], spring: [],
});

/** The contents of a scene file, one field per line. */
function sceneText(scene) {
  const fields = Object.entries(scene).map(([key, value]) => ` ${JSON.stringify(key)}: ${JSON.stringify(value)}`);
  return `{\n${fields.join(",\n")}\n}\n`;
}

class Editor {
  /** stage: draws the scene; on: {change(scene), check({state: of VERDICTS, problems, warnings})}. */
  constructor(stage, on) {
    this.stage = stage;
    this.on = on;
    this.tool = "select";
    this.scene = EMPTY_SCENE();
    this.selected = null;
    this.past = [];
    this.future = [];
    this.answer = { state: "checking", problems: [], warnings: [] };
    this.turn = 0;
    this.opened = false; // the empty scene is not shown before one is opened, so it is nothing to go back to
    this.keep();
  }

  /** Show another scene. What was drawn and not saved can still be undone to, so it can still be lost. */
  open(scene) {
    const { known, ...fields } = scene;
    const lost = this.unsaved;
    const show = () => (this.scene = { joint: [], spring: [], ...structuredClone(fields) });
    if (this.opened) {
      this.change(show);
    } else {
      show();
      this._changed();
    }
    this.opened = true;
    this.keep();
    this.replaced = lost;
  }

  /** Remember the scene as one that is not lost with the page: it was opened or saved. */
  keep() {
    this.kept = JSON.stringify(this.scene);
    this.replaced = false; // whether a drawing that was not saved is in the past alone
  }

  get unsaved() {
    return this.replaced || JSON.stringify(this.scene) !== this.kept;
  }

  /** Change the scene in a way that can be undone. */
  change(act) {
    this._put();
    this.past.push(JSON.stringify(this.scene));
    if (this.past.length > 200) this.past.shift();
    this.future = [];
    act();
    this._changed();
  }

  undo() {
    this._travel(this.past, this.future);
  }

  redo() {
    this._travel(this.future, this.past);
  }

  _travel(from, to) {
    this._put();
    if (!from.length) return;
    to.push(JSON.stringify(this.scene));
    this.scene = JSON.parse(from.pop());
    this._changed();
  }

  /** Forget the object pressed first and end a drag where it is: their indices may not outlive a change. */
  _put() {
    this.first = null;
    this.release();
  }

  async _changed() {
    const count = this.scene.block.length + this.scene.ball.length;
    if (this.selected !== null && this.selected >= count) this.selected = null;
    this.on.change(this.scene);
    const turn = ++this.turn;
    this._show({ state: "checking", problems: [], warnings: [] });
    const known = (answer) => ({ state: answer.problems.length ? "invalid" : "valid", ...answer });
    const unknown = (error) => ({ state: "unknown", problems: [error.message], warnings: [] });
    const answer = await call("check", { scene: this.scene }).then(known, unknown);
    if (turn === this.turn) this._show(answer); // else the scene has changed since
  }

  _show(answer) {
    this.answer = answer;
    this.draw();
    this.on.check(answer);
  }

  /** Handle a press of the pointer. */
  press(point, free) {
    this.release();
    const at = this._snap(point, free);
    const part = this._partAt(point);
    if (this.tool === "bar") this._place(() => this._addBar([at[0] - 50, at[1]], [at[0] + 50, at[1]]));
    else if (this.tool === "ball") this._place(() => this._addBall(at));
    else if (this.tool === "delete") part && this.delete(part.object);
    else if (this.tool === "joint" || this.tool === "spring") this._connect(part);
    else {
      this.selected = part ? part.object : null;
      this.drag = part && { ...part, from: point, before: structuredClone(this.scene), moved: false };
      this.draw();
      this.on.change(this.scene);
    }
  }

  move(point, free) {
    if (!this.drag) return;
    const { object, handle, from, before } = this.drag;
    if (!this.drag.moved && Math.hypot(point[0] - from[0], point[1] - from[1]) < 3) return;
    this.drag.moved = true;
    const by = [point[0] - from[0], point[1] - from[1]];
    const ball = object - before.block.length;
    const shift = ([x, y]) => [x + by[0], y + by[1]];
    if (ball >= 0 && handle === "edge") {
      const [x, y] = before.ball[ball];
      const radius = Math.hypot(point[0] - x, point[1] - y);
      this.scene.ball[ball] = [x, y, free ? radius : Math.max(1, Math.round(radius))];
    } else if (ball >= 0) {
      const [x, y, radius] = before.ball[ball];
      this.scene.ball[ball] = [...this._snap(shift([x, y]), free), radius];
    } else if (handle === "middle") {
      const [a, b] = before.block[object];
      const start = this._snap(shift(a), free);
      this.scene.block[object] = [start, [start[0] + b[0] - a[0], start[1] + b[1] - a[1]]];
    } else {
      this.scene.block[object][handle] = this._snap(shift(before.block[object][handle]), free);
    }
    this.draw();
  }

  /** End a drag where it began: the browser took the pointer for something else. */
  cancel() {
    if (!this.drag) return;
    this.scene = this.drag.before;
    this.drag = null;
    this.draw();
  }

  release() {
    const drag = this.drag;
    this.drag = null;
    if (!drag || !drag.moved) return;
    const after = this.scene;
    this.scene = drag.before;
    this.change(() => (this.scene = after));
  }

  /** Switch a flag of the selected bar: "eli" or "dynamic". */
  mark(kind) {
    const bar = this.selected;
    if (bar === null || bar >= this.scene.block.length) return;
    this.change(() => (this.scene[kind][bar] = this.scene[kind][bar] ? 0 : 1));
  }

  /** Turn the selected bar about its centre, or change its length. */
  reshape(degrees, stretch) {
    const bar = this.selected;
    if (bar === null || bar >= this.scene.block.length) return;
    const [[ax, ay], [bx, by]] = this.scene.block[bar];
    const [cx, cy] = [(ax + bx) / 2, (ay + by) / 2];
    const [cos, sin] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
    const round = (value) => Math.round(value * 1000) / 1000;
    const turned = ([x, y]) => {
      const [u, v] = [(x - cx) * stretch, (y - cy) * stretch];
      return [round(cx + u * cos - v * sin), round(cy + u * sin + v * cos)];
    };
    this.change(() => (this.scene.block[bar] = [turned([ax, ay]), turned([bx, by])]));
  }

  delete(object = this.selected) {
    if (object === null) return;
    this.change(() => {
      const { scene } = this;
      const ball = object - scene.block.length;
      if (ball >= 0) scene.ball.splice(ball, 1);
      else scene.block.splice(object, 1);
      scene.eli.splice(object, 1);
      scene.dynamic.splice(object, 1);
      const renumbered = (pair) => pair.map((index) => index - (index > object));
      for (const key of ["joint", "spring"]) {
        scene[key] = scene[key].filter((pair) => !pair.includes(object)).map(renumbered);
      }
      this.selected = null;
    });
  }

  rename(name) {
    this.change(() => (this.scene.name = name));
  }

  _place(add) {
    this.change(() => (this.selected = add()));
    this.use("select");
  }

  use(tool) {
    this.tool = tool;
    this.first = null;
    this.on.change(this.scene);
    this.draw();
  }

  _addBar(start, end) {
    const { scene } = this;
    const place = scene.block.length;
    const renumbered = (pair) => pair.map((index) => index + (index >= place));
    scene.block.push([start, end]);
    scene.eli.splice(place, 0, 0);
    scene.dynamic.splice(place, 0, 0);
    for (const key of ["joint", "spring"]) scene[key] = scene[key].map(renumbered);
    return place;
  }

  _addBall([x, y]) {
    const { scene } = this;
    scene.ball.push([x, y, 20]);
    scene.eli.push(0);
    scene.dynamic.push(1);
    return scene.block.length + scene.ball.length - 1;
  }

  /** Connect the object to another one pressed before, or remove their connection. */
  _connect(part) {
    if (!part) return;
    const first = this.first ?? null;
    this.selected = part.object;
    this.first = first === null ? part.object : null;
    if (this.first !== null || part.object === first) return void this.draw(); // pressed twice, it is put down again
    const connected = (pair) => pair.includes(first) && pair.includes(part.object);
    const pairs = this.scene[this.tool];
    this.change(() => {
      this.scene[this.tool] = pairs.some(connected) ? pairs.filter((pair) => !connected(pair)) : [...pairs, [first, part.object]];
    });
  }

  _snap(point, free) {
    return point.map((value) => (free ? Math.round(value * 1000) / 1000 : Math.round(value / GRID_STEP) * GRID_STEP));
  }

  /** The part under the pointer; handles of the selected object come first. */
  _partAt(point) {
    const { scene, selected } = this;
    const near = ([x, y]) => Math.hypot(point[0] - x, point[1] - y) <= HANDLE + 3;
    for (const [handle, place] of this._handles()) if (near(place)) return { object: selected, handle };
    const all = [...scene.block, ...scene.ball].map((_, i) => i);
    const object = objectAt(scene, restingPoses(scene), all, point, 6);
    return object === null ? null : { object, handle: "middle" };
  }

  /** The handles of the selected object: the ends of a bar, the edge of a ball. */
  _handles() {
    const { scene, selected } = this;
    if (selected === null) return [];
    if (selected < scene.block.length) return scene.block[selected].map((end, i) => [i, end]);
    const [x, y, radius] = scene.ball[selected - scene.block.length];
    return [["edge", [x + radius, y]]];
  }

  draw() {
    const { scene, stage } = this;
    const poses = restingPoses(scene);
    const wrong = new Set([...this.answer.problems, ...this.answer.warnings].map((line) => objectOf(line, scene)));
    const bad = [...wrong].filter((object) => object !== null && object < poses.length);
    const all = scene.block.length + scene.ball.length;
    const sound = (pairs) => pairs.filter((pair) => pair.every((index) => index < all));
    const shown = { ...scene, joint: sound(scene.joint), spring: sound(scene.spring) };
    stage.draw(shown, { poses, hint: this.selected, marked: bad });
    const pen = stage.canvas.getContext("2d");
    const theme = stage.theme();
    for (const [, [x, y]] of this._handles()) {
      disc(pen, x, y, HANDLE, theme.background);
      disc(pen, x, y, HANDLE - 2, theme.velocity);
    }
    drawMessages(pen, theme, this.answer, scene);
  }
}
