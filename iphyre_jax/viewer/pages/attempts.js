"use strict";
// The attempts of the person: each play that has ended goes to the server, which counts, saves and scores it. What the
// server cannot take now is kept and can be sent again.

const USED_UP = 409; // the status of an attempt that the server will never count

class Attempts {
  /** on: {change(), counted(attempt, answer), refused(attempt, error)}. */
  constructor(on) {
    this.on = on;
    this.unsaved = []; // {scene, plan}
    this.sending = false;
  }

  add(attempt) {
    this.unsaved.push(attempt);
    return this.send();
  }

  /** Send all that are not saved, in order. */
  async send() {
    if (this.sending) return; // and what was added meanwhile is sent too
    this.sending = true;
    this.on.change();
    const kept = [];
    let failure = null;
    for (let attempt; (attempt = this.unsaved.shift()); ) {
      const { scene, plan } = attempt;
      try {
        this.on.counted(attempt, await call("attempt", { scene: nameOrScene(scene), plan }));
      } catch (error) {
        if (error.status === USED_UP) {
          this.on.refused(attempt, error);
          continue;
        }
        kept.push(attempt);
        failure = error;
      }
    }
    this.unsaved.push(...kept);
    this.sending = false;
    this.on.change();
    if (failure) throw failure;
  }
}
