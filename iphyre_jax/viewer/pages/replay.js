"use strict";
// The replay page: choose a game and one or two plays of it.

function startReplay(data) {
  const byId = (id) => document.getElementById(id);
  document.title = data.title;
  byId("title").textContent = data.title;
  byId("about").textContent = `${data.plays.length} plays of ${data.scenes.length} scenes · iphyre_jax ${data.version}`;
  let deck = null;
  const look = new Look(data.themes, byId("look"), () => deck && deck.show());
  deck = new Deck(byId("deck"), () => look.colours);

  const plays = data.scenes.flatMap((_, scene) => numbered(data.plays.filter((play) => play.scene === scene)));
  const option = (value, textContent) => make("option", { value, textContent });
  const [games, left, right] = ["game", "left", "right"].map(byId);
  games.append(...distinct(data.scenes.map((scene) => scene.name)).map((name, i) => option(i, name)));

  const fill = () => {
    const here = plays.flatMap((play, i) => (play.scene === Number(games.value) ? [i] : []));
    const options = () => here.map((i) => option(i, labelOf(plays[i])));
    left.replaceChildren(...options());
    right.replaceChildren(option("", "nobody"), ...options());
    if (here.length > 1 && here.length < 4) right.value = here[1];
    return load();
  };

  const load = async () => {
    const chosen = [left.value, right.value].filter((value) => value !== "").map((value) => plays[Number(value)]);
    await deck.load(chosen.map((play) => ({ title: play.title, play, scene: data.scenes[play.scene] })));
    document.documentElement.dataset.ready = games.value;
  };

  const turn = (by) => {
    games.selectedIndex = (games.selectedIndex + by + games.length) % games.length;
    fill();
  };

  games.onchange = fill;
  left.onchange = right.onchange = load;
  byId("previous").onclick = () => turn(-1);
  byId("next").onclick = () => turn(1);
  document.addEventListener("keydown", (event) => {
    if (deck.key(event) || hasModifier(event) || event.target.closest("select")) return;
    if (event.key === "n") turn(1);
    if (event.key === "p") turn(-1);
  });
  window.addEventListener("resize", () => deck.show());
  fill();
}

startReplay(JSON.parse(document.getElementById("data").textContent));
