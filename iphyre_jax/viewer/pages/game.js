"use strict";
// A running game. The server has computed all frames for the current plan; the page shows them in real time. A click
// adds a removal before the step of the current frame. Then time stops until the server has computed the new frames.

class Game {
  /** stage: draws the game; on: {change(), end(result)}. */
  constructor(stage, on) {
    this.stage = stage;
    this.on = on;
    this.state = "empty"; // empty, ready, running, waiting, over
    this.turn = 0; // of the scene that was asked for last
    this.next = []; // blocks to remove once the frames of the removal before have arrived
    this.away = false; // while another part of the page is shown, time stands still
  }

  /** Prepare an attempt at a scene; `play` is its play without removals. */
  async ready(scene, play) {
    this._become("empty");
    const turn = ++this.turn;
    const tape = await openTape(play, scene);
    if (turn !== this.turn) return; // the user has chosen another scene
    const blocks = eliminableBlocks(scene);
    Object.assign(this, { scene, blocks, plan: blocks.map(() => -1), play, tape, time: 0, hint: null, shown: 0, next: [] });
    this._become("ready");
  }

  start() {
    if (this.state !== "ready") return;
    this._become("running");
    this._run();
  }

  /** Handle a click or tap on a point of the scene. */
  press(point) {
    if (this.state === "ready") this.start();
    else if (this.playing) return this.remove(this._under(point));
    return undefined;
  }

  /** Whether a play has begun and is not over. */
  get playing() {
    return this.state === "running" || this.state === "waiting";
  }

  hover(point) {
    if (this.state === "empty") return;
    this.hint = point && this._under(point);
    this.draw();
  }

  /** Remove a block before the step of the current frame: at most one block per step, none before step 1. */
  async remove(block) {
    if (this.state === "waiting") this.next.push(block);
    const { scene, plan, turn } = this;
    const column = this.blocks.indexOf(block);
    if (column < 0 || plan[column] >= 0 || this.state !== "running") return;
    const step = Math.max(this.shown, 1, ...plan.map((other) => other + 1));
    if (step >= this.tape.frames - 1) return;
    plan[column] = step;
    this._become("waiting");
    try {
      const play = await call("record", { scene: nameOrScene(scene), plan });
      const tape = await openTape(play, scene);
      if (turn === this.turn) Object.assign(this, { play, tape, hint: null });
    } catch (error) {
      plan[column] = -1; // the server did not answer, so nothing is removed
      if (turn === this.turn) this.next = [];
      throw error;
    } finally {
      if (turn === this.turn) {
        this._become("running");
        this._run();
      }
    }
    while (this.state === "running" && this.next.length) await this.remove(this.next.shift());
  }

  /** Skip the rest of the time. */
  finish() {
    if (this.state !== "running") return;
    this.time = (this.tape.frames - 1) / this.tape.fps;
    this._show();
  }

  draw() {
    if (this.state === "empty") return;
    const { tape, shown } = this;
    this.stage.draw(this.scene, {
      poses: tape.pose(shown),
      shareOf: (i) => shareAt(tape, i, shown),
      hint: this.state === "running" || this.state === "ready" ? this.hint : null,
    });
    this.stage.canvas.dataset.frame = shown;
  }

  _under(point) {
    const there = this.blocks.filter((block, column) => this.plan[column] < 0);
    return objectAt(this.scene, this.tape.pose(this.shown), there, point, 8); // 8 px of tolerance, for fingers
  }

  _run() {
    let before = null;
    const run = (this.run = {}); // an answer may come before the next frame: of two runs the newer goes on
    const frame = (now) => {
      if (this.state !== "running" || this.run !== run) return;
      // A hidden page does not jump ahead.
      if (before !== null && !this.away) this.time += Math.min(0.1, (now - before) / 1000);
      before = now;
      if (!this.away) this._show();
      if (this.state === "running") requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  _show() {
    this.shown = frameAt(this.time, this.tape);
    this.draw();
    this.on.change();
    if (this.shown === this.tape.frames - 1) {
      this._become("over");
      this.on.end({ scene: this.scene, plan: this.plan });
    }
  }

  _become(state) {
    this.state = state;
    this.stage.canvas.dataset.state = state;
    this.draw();
    this.on.change();
  }
}

/** What to send for a scene: the name of a game, or the contents of another scene. */
const nameOrScene = (scene) => scene.known || scene;
