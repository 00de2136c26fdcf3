"use strict";
// The check of the scene in the editor: its words, and its lines on the canvas.

const VERDICTS = {
  checking: "Checking the scene …",
  unknown: "The scene could not be checked",
  valid: "The scene is valid",
  invalid: "The scene is not valid yet",
};

/** The object that a line of the check names, or null: "block[2][0]: ...", "ball[0]: ...", "eli[3]: ...". */
function objectOf(line, scene) {
  const found = /^(block|ball|eli|dynamic)\[(\d+)\]/.exec(line);
  if (!found) return null;
  return Number(found[2]) + (found[1] === "ball" ? scene.block.length : 0);
}

/** Write the lines of the check on the canvas: near the object they name, or in the upper left corner. */
function drawMessages(pen, theme, answer, scene) {
  const poses = restingPoses(scene);
  pen.font = "13px system-ui, sans-serif";
  pen.textBaseline = "middle";
  let corner = 16;
  const lines = [...answer.problems.map((text) => [text, theme.failed]), ...answer.warnings.map((text) => [text, theme.quiet])];
  const taken = []; // rectangles with text: [left, top, right, bottom], px
  for (const [text, colour] of lines.slice(0, 12)) {
    const object = objectOf(text, scene);
    const here = object !== null && object < poses.length;
    const parts = wrapped(pen, text, 290);
    const width = Math.max(...parts.map((part) => pen.measureText(part).width));
    const x = here ? Math.min(Math.max(8, poses[object][0] - width / 2), SIDE - width - 12) : 8;
    const height = 17 * parts.length;
    const coveredBy = (top) => taken.find(([l, t, r, b]) => x < r && x + width > l && top < b && top + height > t);
    let y = here ? Math.min(Math.max(16, poses[object][1] + 34), SIDE - height) : corner;
    for (let other; (other = coveredBy(y - 9)); ) y = other[3] + 9;
    taken.push([x, y - 9, x + width, y - 9 + height]);
    for (const part of parts) {
      pen.globalAlpha = 0.9;
      pen.fillStyle = theme.background;
      pen.fillRect(x - 4, y - 9, pen.measureText(part).width + 8, 18);
      pen.globalAlpha = 1;
      pen.fillStyle = colour;
      pen.fillText(part, x, y);
      y += 17;
    }
    if (!here) corner = y + 6;
  }
}

function wrapped(pen, text, width) {
  const rows = [""];
  for (const word of text.slice(0, 200).split(" ")) {
    const longer = rows.at(-1) ? `${rows.at(-1)} ${word}` : word;
    if (pen.measureText(longer).width <= width || !rows.at(-1)) rows[rows.length - 1] = longer;
    else rows.push(word);
  }
  return rows;
}
