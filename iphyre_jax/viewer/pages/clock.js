"use strict";
// The clock: the time of a play in seconds. It can run, stop, jump and loop, and calls `tick` after every change.

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

/** The frame at a time. The small number makes up for rounding, so that the time of a frame gives that frame. */
const frameAt = (seconds, tape) => Math.min(tape.frames - 1, Math.floor(seconds * tape.fps + 1e-6));
