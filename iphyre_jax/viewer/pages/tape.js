"use strict";
// Tapes: the frames of a play, packed by iphyre_jax/viewer/pack.py.

const UNITS = { length: 1 / 64, angle: 1 / 4096, speed: 1 / 4, contact: 1 / 4 };

/** Unpack a tape. Returns {frames, pose(k), velocity(k), contacts(k), lastFrame(object)}. */
async function openTape(play, scene) {
  const bytes = Uint8Array.from(atob(play.tape), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const grown = new Int32Array(await new Response(stream).arrayBuffer());
  const frames = play.steps + 1;
  const moving = scene.dynamic.flatMap((flag, i) => (flag ? [i] : []));
  const columns = moving.length * 5;
  const values = Float64Array.from(grown);
  for (let c = 0; c < columns; c++) {
    for (let k = 1; k < frames; k++) values[c * frames + k] += values[c * frames + k - 1];
  }
  const starts = new Int32Array(frames + 1);
  for (let k = 0, count = 0; k < frames; k++) {
    count += grown[columns * frames + k];
    starts[k + 1] = starts[k] + count;
  }
  const first = (columns + 1) * frames;
  for (let k = first + 2; k < values.length; k++) values[k] += values[k - 2];
  const rest = restingPoses(scene);
  const lasts = lastFrames(play, scene);

  return {
    frames,
    fps: play.fps,
    /** [x, y, angle] of every object, px and rad, y down. */
    pose(k) {
      const poses = rest.map((pose) => pose.slice());
      moving.forEach((object, m) => {
        const at = (column) => values[(m * 3 + column) * frames + k];
        poses[object] = [at(0) * UNITS.length, at(1) * UNITS.length, at(2) * UNITS.angle];
      });
      return poses;
    },
    /** {object, vx, vy} of every moving object, px/s. */
    velocity(k) {
      const from = moving.length * 3;
      return moving.map((object, m) => ({
        object,
        vx: values[(from + m * 2) * frames + k] * UNITS.speed,
        vy: values[(from + m * 2 + 1) * frames + k] * UNITS.speed,
      }));
    },
    /** [x, y] of every contact point, px. */
    contacts(k) {
      const points = [];
      for (let i = starts[k]; i < starts[k + 1]; i++) {
        points.push([values[first + 2 * i] * UNITS.contact, values[first + 2 * i + 1] * UNITS.contact]);
      }
      return points;
    },
    /** How many frames ago an object was removed; 0 or less while it is present. */
    goneFor: (object, k) => k - lasts[object],
  };
}

/** The start pose of every object: [x, y, angle]. */
function restingPoses(scene) {
  const bars = scene.block.map(([[ax, ay], [bx, by]]) => [(ax + bx) / 2, (ay + by) / 2, 0]);
  return [...bars, ...scene.ball.map(([x, y]) => [x, y, 0])];
}

/** Object indices of the blocks that can be removed, in the order of a plan. */
function eliminableBlocks(scene) {
  return scene.block.map((_, i) => i).filter((i) => scene.eli[i]);
}

/** The last frame in which each object is present. */
function lastFrames(play, scene) {
  const lasts = [...scene.block, ...scene.ball].map(() => Infinity);
  eliminableBlocks(scene).forEach((block, column) => {
    const step = play.plan[column];
    if (step >= 0 && step < play.steps) lasts[block] = step;
  });
  return lasts;
}
