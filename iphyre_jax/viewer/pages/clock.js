"use strict";
// The clock: time of a play in seconds, which runs, stands, jumps and repeats. It calls `tick` whenever it has changed.

class Clock {
  constructor(tick) {
    this.tick = tick;
    this.length = 0; // s
    this.now = 0; // s
    this.speed = 1;
    this.loop = false;
    this.running = false;
    this._before = null;
  }

  start() {
    if (this.running) return;
    if (this.now >= this.length) this.now = 0;
    this.running = true;
    this._before = null;
    requestAnimationFrame((time) => this._frame(time));
    this.tick();
  }

  stop() {
    this.running = false;
    this.tick();
  }

  toggle() {
    if (this.running) this.stop();
    else this.start();
  }

  jump(seconds) {
    this.now = Math.min(this.length, Math.max(0, seconds));
    this._before = null;
    this.tick();
  }

  _frame(time) {
    if (!this.running) return;
    if (this._before !== null) this.now += ((time - this._before) / 1000) * this.speed;
    this._before = time;
    if (this.now >= this.length) {
      this.now = this.loop && this.length ? this.now % this.length : this.length;
      this.running = this.loop;
    }
    this.tick();
    if (this.running) requestAnimationFrame((next) => this._frame(next));
  }
}

/** The frame that is shown at a time; the small part keeps a time that stands for a frame from rounding below it. */
const frameAt = (seconds, tape) => Math.min(tape.frames - 1, Math.floor(seconds * tape.fps + 1e-6));
