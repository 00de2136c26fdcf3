"use strict";
// The play page: a game, plays side by side, and the scene editor, on one page.

const NOBODY = "Nobody has played this scene yet";
const PREPARING = "Preparing the simulator. The first time takes seconds, with many moving objects minutes …";
const byId = (id) => document.getElementById(id);

class PlayPage {
  constructor(start) {
    this.start = start;
    this.scenes = start.games.map((game) => game.scene);
    const redraw = () => [this.game, this.deck, this.editor].forEach((part) => part && (part.draw || part.show).call(part));
    this.look = new Look(start.themes, byId("look"), redraw);
    const theme = () => this.look.colours;
    this.game = new Game(new Stage(byId("board"), theme), {
      change: () => this.showState(),
      end: (attempt) => this.attempt(() => this.attempts.add(attempt)),
    });
    this.attempts = new Attempts({
      change: () => this.showState(),
      counted: (attempt, answer) => this.counted(attempt, answer),
      refused: (attempt, error) => this.attempt(() => this.refused(attempt, error)),
    });
    this.deck = new Deck(byId("deck"), theme);
    this.drawing = new Drawing(new Stage(byId("sketch"), theme));
    this.editor = this.drawing.editor;
    byId("source").textContent = `Paper: ${start.source.source}. ${start.source.protocol}.`;
    this.fillGames();
    this.wire();
    window.addEventListener("resize", redraw);
    window.addEventListener("beforeunload", (event) => {
      if (this.editor.unsaved || this.attempts.unsaved.length) event.preventDefault();
    });
  }

  fillGames() {
    const groups = new Map();
    const names = distinct(this.start.games.map((game) => game.name));
    this.start.games.forEach((game, i) => {
      if (!groups.has(game.split)) groups.set(game.split, make("optgroup", { label: game.split }));
      groups.get(game.split).append(make("option", { value: i, textContent: names[i] }));
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
    on("resend", () => this.attempts.send());
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

    this.drawing.wire(on, (act) => this.attempt(act));
    on("copy", () => editor.open(this.scene || EMPTY_SCENE()));
    on("run", () => this.runScene());
    document.addEventListener("keydown", (event) => {
      const act = this.key(event);
      if (act) this.attempt(act); // other keys leave an error message where it is
    });
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
    if (name === "edit") {
      if (this.editor.opened) this.editor.draw();
      else this.editor.open(this.scene || EMPTY_SCENE());
      return undefined;
    }
    return void this.game.draw();
  }

  turn(by) {
    const games = byId("game");
    games.selectedIndex = (games.selectedIndex + by + games.length) % games.length;
    return this.choose();
  }

  /** Take the chosen game. */
  async choose() {
    const { value } = byId("game");
    await this.take(this.scenes[Number(value)], value);
    if (this.shown === "compare") await this.compare();
  }

  /** Take a scene: the name of a game or the contents of a scene; place: its value in the list of games, or "". */
  async take(wanted, place) {
    const turn = (this.turns = (this.turns || 0) + 1);
    byId("status").textContent = PREPARING;
    document.documentElement.dataset.ready = "";
    try {
      const answer = await call("game", { scene: wanted });
      if (turn !== this.turns) return;
      byId("status").textContent = "";
      this.scene = { ...answer.scene, known: typeof wanted === "string" ? wanted : undefined };
      this.place = place;
      this.untouched = answer.play;
      this.standing = answer.standing;
      this.answer = answer;
      await this.prepare();
    } finally {
      if (turn === this.turns) {
        byId("game").value = this.place ?? ""; // also if another one was refused
        document.documentElement.dataset.ready = this.scene ? this.scene.name : "";
      }
    }
  }

  /** Prepare the next attempt. */
  async prepare() {
    byId("result").textContent = "";
    byId("name").textContent = this.scene.name;
    byId("compare-now").hidden = true;
    await this.game.ready(this.scene, this.untouched);
    this.showScores();
  }

  /** The server has counted an attempt. */
  counted({ scene }, { play, standing }) {
    if (!this.isShown(scene)) return;
    this.standing = standing;
    if (this.game.state === "over") {
      byId("result").textContent = `${play.solved ? "Solved" : "Not solved"}: ${points(play.reward)}`;
      byId("result").className = `big ${play.solved ? "solved" : "failed"}`;
      byId("result").dataset.plan = JSON.stringify(play.plan);
      byId("result").dataset.reward = play.reward;
      byId("compare-now").hidden = false;
    }
    this.showScores();
  }

  /** The server does not count an attempt: perhaps those of another tab have used all. */
  async refused({ scene }, error) {
    if (!this.isShown(scene)) return;
    byId("result").textContent = `Not counted: ${error.message}`;
    const { standing } = await call("game", { scene: nameOrScene(scene) });
    if (!this.isShown(scene)) return;
    this.standing = standing;
    this.showScores();
  }

  isShown(scene) {
    return JSON.stringify(scene) === JSON.stringify(this.scene);
  }

  /** Show time and buttons. */
  showState() {
    const { game } = this;
    if (game.state === "empty") return;
    byId("time").textContent = seconds(game.shown / game.tape.fps);
    byId("start").textContent = game.state === "over" ? "Try again" : "Start";
    const unsaved = this.attempts.unsaved.length;
    const waits = game.state === "over" && (this.attempts.sending || !this.standing.left);
    byId("start").disabled = game.playing || waits;
    byId("finish").disabled = game.state !== "running";
    byId("resend").hidden = !unsaved;
    byId("resend").disabled = this.attempts.sending;
    byId("resend").textContent = unsaved > 1 ? `Save these ${unsaved} attempts again` : "Save this attempt again";
  }

  showScores() {
    const { standing, answer } = this;
    const { figures, best } = answer;
    const rewards = standing.rewards.map(points).join(", ");
    const left = `${standing.left} of ${this.start.attempts} attempts left`;
    byId("standing").textContent = rewards ? `${left}; so far ${rewards}` : left;
    byId("again").hidden = standing.left > 0;
    this.showState();
    const rows = [["best of these attempts", standing.best, true]];
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
    if (!scene) return;
    const { plays, failed } = await call("agents", { scene: nameOrScene(scene) });
    if (scene !== this.scene || this.shown !== "compare") return; // the user has chosen something else
    this.plays = numbered(plays);
    const option = (play, i) => make("option", { value: i, textContent: labelOf(play) });
    const mine = this.plays.findLastIndex((play) => play.own);
    const other = this.plays.findIndex((play) => !play.own);
    byId("left").replaceChildren(...this.plays.map(option));
    byId("right").replaceChildren(make("option", { value: "", textContent: "nobody" }), ...this.plays.map(option));
    byId("left").value = mine >= 0 ? mine : other;
    byId("right").value = mine >= 0 && other >= 0 ? other : "";
    if (!this.plays.length) byId("status").textContent = NOBODY;
    for (const part of byId("compare").children) part.hidden = !this.plays.length;
    await this.loadDeck();
    if (failed.length) throw new Error(failed.join("; "));
  }

  async loadDeck() {
    const chosen = [byId("left").value, byId("right").value].filter((value) => value !== "");
    const plays = chosen.map((value) => this.plays[Number(value)]);
    await this.deck.load(plays.map((play) => ({ title: play.title, play, scene: this.scene })));
  }

  /** Play the scene in the editor. */
  async runScene() {
    await this.take(structuredClone(this.editor.scene), "");
    await this.mode("play");
  }

  /** Return what a key does; undefined for the keys of the browser. */
  key(event) {
    if (this.shown === "compare") return void this.deck.key(event);
    if (event.target.closest("select, input")) return undefined;
    return this.shown === "play" ? this.playKey(event) : this.drawing.key(event);
  }

  playKey(event) {
    const { game } = this;
    if (hasModifier(event)) return undefined;
    if (event.key === " " && !event.target.closest("button, summary")) {
      if (game.playing || game.state === "ready") event.preventDefault(); // else it scrolls the page
      return game.state === "ready" ? () => game.start() : undefined;
    }
    // The digits remove the blocks in the order of the plan, for people who do not use a pointer.
    const block = /^[0-9]$/.test(event.key) && game.playing ? game.blocks[(Number(event.key) + 9) % 10] : undefined;
    return block === undefined ? undefined : () => game.remove(block);
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
    byId("keys").textContent = "Keys: space starts the game; 1 to 9, then 0, remove the blocks in order.";
    await page.attempt(() => page.choose());
  } catch (error) {
    byId("error").textContent = error.message;
    byId("error").hidden = false;
  }
})();
