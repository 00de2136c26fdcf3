"use strict";
// The deck: plays side by side with one clock and one set of controls.

/** Make an element. Text is always inserted as text, never as markup. */
function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in element && name !== "list") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

const seconds = (value) => `${value.toFixed(2)} s`;
const points = (value) => value.toFixed(2);

/** Whether a key is pressed for the browser, as in Ctrl+1. */
const hasModifier = (event) => event.ctrlKey || event.metaKey || event.altKey;

/** Give plays of one scene titles: the agent, with a number where it has several. */
function numbered(plays) {
  const titles = distinct(plays.map((play) => play.agent));
  return plays.map((play, i) => ({ ...play, title: titles[i] }));
}

/** Names of which those that are there more than once have a number. */
function distinct(names) {
  const counts = new Map();
  const count = (name) => counts.set(name, (counts.get(name) || 0) + 1).get(name);
  const numbers = names.map(count);
  return names.map((name, i) => (counts.get(name) > 1 ? `${name} #${numbers[i]}` : name));
}

const labelOf = (play) => `${play.title} · ${points(play.reward)} · ${play.fps} steps/s`;

/** The result of a play in words. */
function endOf(play) {
  const state = play.fault ? `invalid physics (fault ${play.fault})` : play.solved ? "solved" : "not solved";
  const removed = `${play.eliminations} block${play.eliminations === 1 ? "" : "s"} removed`;
  return `${state} · ${points(play.reward)} · ${seconds(play.steps / play.fps)} · ${removed} · ${play.fps} steps/s`;
}

class Deck {
  /** Fills `place` with stages and controls. */
  constructor(place, theme) {
    this.theme = theme;
    this.clock = new Clock(() => this.show());
    this.panels = [];
    this.rate = 1; // frames a second, the highest of the plays
    this.options = { trails: true, contacts: false, velocities: false };
    this.stages = make("div", { className: "stages" });
    place.append(this.stages, this._controls());
  }

  _controls() {
    const button = (label, title, act) => make("button", { type: "button", title, textContent: label, onclick: act });
    this.playButton = button("Play", "play or pause (space)", () => this.clock.toggle());
    this.playButton.classList.add("main", "play");
    this.slider = make("input", { type: "range", min: 0, max: 0, step: 1, value: 0, className: "scrub" });
    this.slider.setAttribute("aria-label", "frame");
    this.slider.oninput = () => {
      const frame = Number(this.slider.value); // read it first: stopping moves the slider to the current frame
      this.clock.stop();
      this.clock.jump(frame / this.rate);
    };
    this.time = make("output", { className: "time", "aria-live": "off" });
    this.speed = make("select", { title: "speed (+ and -)" });
    this.speed.setAttribute("aria-label", "speed");
    for (const value of [0.1, 0.25, 0.5, 1, 2, 4]) {
      this.speed.append(make("option", { value, textContent: `${value}×`, selected: value === 1 }));
    }
    this.speed.onchange = () => (this.clock.speed = Number(this.speed.value));
    const check = (label, key, get, set) => {
      const box = make("input", { type: "checkbox", checked: get() });
      box.onchange = () => {
        set(box.checked);
        this.show();
      };
      this.boxes = { ...this.boxes, [key]: box };
      return make("label", { title: `${label} (${key})` }, box, label);
    };
    const option = (name, key) => check(name, key, () => this.options[name], (on) => (this.options[name] = on));
    const row = make("div", { className: "row" });
    row.append(
      this.playButton,
      button("‹ step", "one step back (left arrow)", () => this.step(-1)),
      button("step ›", "one step forward (right arrow)", () => this.step(1)),
      this.slider,
      this.time,
    );
    const more = make("div", { className: "row" });
    more.append(
      this.speed,
      check("loop", "l", () => this.clock.loop, (on) => (this.clock.loop = on)),
      option("trails", "t"),
      option("contacts", "c"),
      option("velocities", "v"),
    );
    return make("div", { className: "controls" }, row, more);
  }

  /** Show plays, a list of {title, play, scene}, which may be empty; this opens their tapes. */
  async load(entries) {
    const turn = (this.turn = (this.turn || 0) + 1);
    const tapes = await Promise.all(entries.map(({ play, scene }) => openTape(play, scene)));
    if (turn !== this.turn) return; // another call came later
    this.clock.stop();
    this.panels = entries.map((entry, i) => this._panel(entry, tapes[i]));
    this.stages.replaceChildren(...this.panels.map((panel) => panel.figure));
    this.rate = Math.max(1, ...tapes.map((tape) => tape.fps));
    this.clock.length = Math.max(0, ...tapes.map((tape) => (tape.frames - 1) / tape.fps));
    this.slider.max = Math.round(this.clock.length * this.rate);
    this.clock.jump(0);
  }

  _panel({ title, play, scene }, tape) {
    const canvas = make("canvas");
    canvas.setAttribute("role", "img");
    const caption = make("figcaption", {}, make("strong", { textContent: title }), make("span", { className: "end" }));
    const figure = make("figure", {}, canvas, caption);
    canvas.onclick = () => this.clock.toggle();
    return { figure, canvas, stage: new Stage(canvas, this.theme), play, scene, tape, title };
  }

  /** The current frame at the highest frame rate of the plays. */
  get frame() {
    return Math.floor(this.clock.now * this.rate + 1e-6);
  }

  step(frames) {
    this.clock.stop();
    this.clock.jump((this.frame + frames) / this.rate);
  }

  /** Draw everything at the time of the clock. */
  show() {
    this.playButton.textContent = this.clock.running ? "Pause" : "Play";
    this.slider.value = this.frame;
    this.time.textContent = `${seconds(this.clock.now)} / ${seconds(this.clock.length)}`;
    for (const panel of this.panels) this._show(panel);
  }

  _show({ canvas, figure, stage, play, scene, tape, title }) {
    const k = frameAt(this.clock.now, tape);
    const over = k === tape.frames - 1 && this.clock.now > 0;
    stage.draw(scene, {
      poses: tape.pose(k),
      shareOf: (i) => shareAt(tape, i, k),
      trails: this.options.trails ? trailsOf(scene, tape, k) : [],
      contacts: this.options.contacts ? tape.contacts(k) : [],
      velocities: this.options.velocities ? tape.velocity(k) : [],
    });
    const end = figure.querySelector(".end");
    end.textContent = over ? endOf(play) : `${play.fps} steps/s`;
    end.className = `end ${over ? (play.solved ? "solved" : "failed") : ""}`;
    canvas.setAttribute("aria-label", `${title}, frame ${k} of ${tape.frames - 1}`);
    canvas.dataset.frame = k;
  }

  /** Handle a key; return whether it has a meaning. */
  key(event) {
    const typing = event.target.closest("input:not([type=range], [type=checkbox]), textarea, select");
    const presses = event.key === " " && event.target.closest("button, input[type=checkbox]");
    if (hasModifier(event) || typing || presses) return false;
    const many = event.shiftKey ? 10 : 1;
    const speed = (by) => {
      this.speed.selectedIndex = Math.min(this.speed.length - 1, Math.max(0, this.speed.selectedIndex + by));
      this.speed.onchange();
    };
    const acts = {
      " ": () => this.clock.toggle(),
      ArrowLeft: () => this.step(-many),
      ArrowRight: () => this.step(many),
      Home: () => this.clock.jump(0),
      End: () => this.clock.jump(this.clock.length),
      "+": () => speed(1),
      "-": () => speed(-1),
    };
    const act = acts[event.key];
    if (act) act();
    else if (this.boxes[event.key]) this.boxes[event.key].click();
    else return false;
    event.preventDefault();
    return true;
  }
}

/** Opacity of an object: 1 while it is present, then it fades. */
function shareAt(tape, object, k) {
  const gone = tape.goneFor(object, k);
  return gone <= 0 ? 1 : Math.max(0, 1 - gone / (FADE * tape.fps));
}

/** The paths of the balls in the last 4 s. */
function trailsOf(scene, tape, k) {
  const first = Math.max(0, k - 4 * tape.fps);
  const count = Math.min(60, k - first);
  const frames = Array.from({ length: count + 1 }, (_, i) => Math.round(first + ((k - first) * i) / (count || 1)));
  const poses = frames.map((frame) => tape.pose(frame));
  return scene.ball.map((_, b) => poses.map((pose) => pose[scene.block.length + b].slice(0, 2)));
}

/** The colours: those of the device, until the user chooses others. */
class Look {
  constructor(themes, button, changed) {
    this.themes = themes;
    this.changed = changed;
    this.system = window.matchMedia("(prefers-color-scheme: dark)");
    this.chosen = null;
    this.names = { modern: "Light", dark: "Dark", official: "Official" };
    this.system.addEventListener("change", () => this.apply());
    button.onclick = () => {
      const order = Object.keys(this.names);
      this.chosen = order[(order.indexOf(this.name) + 1) % order.length];
      this.apply();
    };
    this.button = button;
    this.apply();
  }

  get name() {
    return this.chosen || (this.system.matches ? "dark" : "modern");
  }

  get colours() {
    return this.themes[this.name];
  }

  apply() {
    document.documentElement.dataset.theme = this.name === "dark" ? "dark" : "light";
    this.button.textContent = `Look: ${this.names[this.name]}`;
    this.changed();
  }
}
