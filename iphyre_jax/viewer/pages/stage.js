"use strict";
// The stage: a canvas that draws a scene in given poses. It knows nothing about time.

const SIDE = 600; // px, visible part of the scene
const BAR_RADIUS = 10;
const FADE = 0.4; // s in which a removed block fades

class Stage {
  /** theme: a function that returns the current colours; the user can change them. */
  constructor(canvas, theme) {
    this.canvas = canvas;
    this.theme = theme;
  }

  /** Fit the canvas to its size on the page; return canvas pixels per pixel of the scene. */
  fit() {
    const shown = this.canvas.clientWidth || SIDE;
    const side = Math.round(shown * (window.devicePixelRatio || 1));
    if (this.canvas.width !== side || this.canvas.height !== side) this.canvas.width = this.canvas.height = side;
    return side / SIDE;
  }

  /** The point of the scene under a pointer. */
  pointOf(event) {
    const box = this.canvas.getBoundingClientRect();
    const scale = SIDE / (box.width || SIDE);
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  /**
   * Draw a scene.
   * show: {poses, shareOf(object) 0 to 1, trails, contacts, velocities, marked: Set of objects, hint: object or null}
   */
  draw(scene, show) {
    const pen = this.canvas.getContext("2d");
    const scale = this.fit();
    const theme = this.theme();
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.globalAlpha = 1;
    pen.fillStyle = theme.background;
    pen.fillRect(0, 0, SIDE, SIDE);
    if (theme.outlined) drawGrid(pen, theme);
    const share = show.shareOf || (() => 1);
    const bars = scene.block.map((_, i) => i);
    const still = bars.filter((i) => !scene.dynamic[i]);
    for (const i of still) drawBar(pen, theme, scene, i, show.poses[i], share(i));
    for (const trail of show.trails || []) drawTrail(pen, theme, trail);
    for (const i of bars.filter((i) => scene.dynamic[i])) drawBar(pen, theme, scene, i, show.poses[i], share(i));
    scene.ball.forEach((ball, k) => drawBall(pen, theme, ball[2], show.poses[scene.block.length + k]));
    const linked = ([i, j]) => share(i) === 1 && share(j) === 1;
    for (const pair of (scene.joint || []).filter(linked)) drawJoint(pen, theme, ends(show.poses, pair), dotsOf(theme, scene, pair));
    for (const pair of (scene.spring || []).filter(linked)) drawSpring(pen, theme, ends(show.poses, pair), dotsOf(theme, scene, pair));
    for (const { object, vx, vy } of show.velocities || []) drawArrow(pen, theme, show.poses[object], vx, vy);
    for (const point of show.contacts || []) drawContact(pen, theme, point);
    for (const object of show.marked || []) drawHalo(pen, scene, object, show.poses[object], theme.failed, 8, [4, 3]);
    if (show.hint !== undefined && show.hint !== null) {
      drawHalo(pen, scene, show.hint, show.poses[show.hint], theme.text, 4, []);
    }
  }
}

const ends = (poses, [i, j]) => [poses[i], poses[j]];

/** End points of a bar in a pose. */
function barEnds(scene, bar, [x, y, angle]) {
  const [[ax, ay], [bx, by]] = scene.block[bar];
  const [cx, cy] = [(ax + bx) / 2, (ay + by) / 2];
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return [[ax - cx, ay - cy], [bx - cx, by - cy]].map(([u, v]) => [x + u * cos - v * sin, y + u * sin + v * cos]);
}

/** Distance of a point from the border of an object, px; negative inside. */
function distanceTo(scene, object, pose, [px, py]) {
  if (object >= scene.block.length) {
    return Math.hypot(px - pose[0], py - pose[1]) - scene.ball[object - scene.block.length][2];
  }
  const [[ax, ay], [bx, by]] = barEnds(scene, object, pose);
  const size = (bx - ax) ** 2 + (by - ay) ** 2;
  const along = size ? Math.min(1, Math.max(0, ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / size)) : 0;
  return Math.hypot(px - ax - along * (bx - ax), py - ay - along * (by - ay)) - BAR_RADIUS;
}

/** The nearest of some objects within reach of a point, or null. */
function objectAt(scene, poses, objects, point, reach) {
  const near = objects.map((object) => [distanceTo(scene, object, poses[object], point), object]);
  const [distance, object] = near.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity, null]);
  return distance <= reach ? object : null;
}

function drawGrid(pen, theme) {
  pen.strokeStyle = theme.grid;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let at = 100; at < SIDE; at += 100) {
    pen.moveTo(at, 0);
    pen.lineTo(at, SIDE);
    pen.moveTo(0, at);
    pen.lineTo(SIDE, at);
  }
  pen.stroke();
}

function drawBar(pen, theme, scene, bar, pose, share) {
  if (share <= 0) return;
  const [[ax, ay], [bx, by]] = barEnds(scene, bar, pose);
  const line = (colour, width) => {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.lineCap = "round";
    pen.beginPath();
    pen.moveTo(ax, ay);
    pen.lineTo(bx, by);
    pen.stroke();
  };
  pen.globalAlpha = share;
  const width = 2 * BAR_RADIUS + 1;
  const kind = scene.eli[bar] ? "eliminable" : scene.dynamic[bar] ? "moving" : "fixed";
  if (theme.outlined && scene.eli[bar]) line(theme.edge, width);
  line(theme[kind], theme.outlined && scene.eli[bar] ? width - 3.2 : width);
  pen.globalAlpha = 1;
}

function drawBall(pen, theme, radius, [x, y, angle]) {
  disc(pen, x, y, radius + 0.5, theme.outlined ? theme.edge : theme.ball);
  const inner = theme.outlined ? radius - 1.1 : radius;
  disc(pen, x, y, inner, theme.ball);
  pen.strokeStyle = theme.spoke;
  pen.lineWidth = theme.outlined ? 2 : 1;
  pen.lineCap = "butt";
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(x + inner * Math.cos(angle), y + inner * Math.sin(angle));
  pen.stroke();
}

function disc(pen, x, y, radius, colour) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.arc(x, y, Math.max(0, radius), 0, 2 * Math.PI);
  pen.fill();
}

/** The radii of the dots at the ends of a link, px: none hides the ball that it sits on, but in the official picture. */
function dotsOf(theme, scene, pair) {
  const radius = (index) => (theme.outlined && scene.ball[index - scene.block.length]?.[2] / 2) || 5;
  return pair.map((index) => Math.min(5, radius(index)));
}

function drawJoint(pen, theme, ends, dots) {
  polyline(pen, theme.joint, ends);
  ends.forEach(([x, y], i) => disc(pen, x, y, dots[i], theme.joint));
}

/** A zigzag in the middle 0.6 of the length, with a crest 6 px high every 0.05: as in observations/drawing.py. */
function drawSpring(pen, theme, ends, dots) {
  const [[ax, ay], [bx, by]] = ends;
  const length = Math.hypot(bx - ax, by - ay) || 1;
  const [nx, ny] = [(-(by - ay) / length) * 6, ((bx - ax) / length) * 6];
  const at = (along, across) => [ax + (bx - ax) * along + nx * across, ay + (by - ay) * along + ny * across];
  const crests = Array.from({ length: 12 }, (_, k) => at(0.225 + 0.05 * k, k % 2 ? 1 : -1));
  polyline(pen, theme.spring, [at(0, 0), at(0.2, 0), ...crests, at(0.8, 0), at(1, 0)]);
  ends.forEach(([x, y], i) => disc(pen, x, y, dots[i], theme.spring));
}

function polyline(pen, colour, points, width = 2, cap = "round") {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineJoin = "round";
  pen.lineCap = cap;
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function drawTrail(pen, theme, points) {
  points.slice(1).forEach((point, k) => {
    pen.globalAlpha = 0.08 + (0.42 * (k + 1)) / points.length;
    polyline(pen, theme.ball, [points[k], point], 3, "butt");
  });
  pen.globalAlpha = 1;
}

/** An arrow as long as the distance covered in a quarter of a second. */
function drawArrow(pen, theme, [x, y], vx, vy) {
  const [dx, dy] = [vx / 4, vy / 4];
  const length = Math.hypot(dx, dy);
  if (length < 2) return;
  const [ux, uy] = [dx / length, dy / length];
  const tip = [x + dx, y + dy];
  const barb = (side) => [tip[0] - 7 * ux + side * 4 * uy, tip[1] - 7 * uy - side * 4 * ux];
  polyline(pen, theme.background, [[x, y], tip], 4);
  polyline(pen, theme.velocity, [[x, y], tip]);
  polyline(pen, theme.velocity, [barb(1), tip, barb(-1)]);
}

function drawContact(pen, theme, [x, y]) {
  polyline(pen, theme.background, [[x - 5, y], [x + 5, y]], 5);
  polyline(pen, theme.background, [[x, y - 5], [x, y + 5]], 5);
  polyline(pen, theme.contact, [[x - 5, y], [x + 5, y]]);
  polyline(pen, theme.contact, [[x, y - 5], [x, y + 5]]);
}

/** A line around an object, `apart` px away from it. */
function drawHalo(pen, scene, object, pose, colour, apart, dash) {
  pen.strokeStyle = colour;
  pen.lineWidth = 2;
  pen.setLineDash(dash);
  pen.beginPath();
  if (object >= scene.block.length) {
    pen.arc(pose[0], pose[1], scene.ball[object - scene.block.length][2] + apart, 0, 2 * Math.PI);
  } else {
    const [[ax, ay], [bx, by]] = barEnds(scene, object, pose);
    const turn = Math.atan2(by - ay, bx - ax);
    pen.arc(ax, ay, BAR_RADIUS + apart, turn + Math.PI / 2, turn - Math.PI / 2);
    pen.arc(bx, by, BAR_RADIUS + apart, turn - Math.PI / 2, turn + Math.PI / 2);
    pen.closePath();
  }
  pen.stroke();
  pen.setLineDash([]);
}
