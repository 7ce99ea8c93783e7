// What is drawn on the image: points, skeleton, the two vectors, the angle, suggestions, the crosshair. All in screen
// px of the given view, on a cleared context; marks keep their size at every zoom.

import { ANGLE, DARK, DISAGREEMENT, FIXED_END, MOVING_END, colourOf, shapePath } from "./palette.js";

const RADIUS_PX = 7;
const LETTERS = '600 11.5px system-ui, -apple-system, "Segoe UI", sans-serif';
const NUMBER = '700 17px system-ui, -apple-system, "Segoe UI", sans-serif';

/** scene: as `makeScene` gives it. */
export function drawMarks(context, scene) {
  const shown = scene.keypoints
    .map((name, index) => ({ name, index, xy: scene.points[name] }))
    .filter((point) => point.xy)
    .map((point) => ({ ...point, at: scene.view.toScreen(point.xy) }));
  if (scene.cursor) drawCrosshair(context, scene);
  drawSkeleton(context, scene, shown);
  const vectors = endVectors(scene);
  for (const vector of vectors) drawArrow(context, vector);
  if (scene.angleDeg !== null && vectors.length === 2) drawAngle(context, scene, vectors, shown);
  if (scene.suggestionsShown) drawSuggestions(context, scene);
  for (const point of shown) drawPoint(context, scene, point);
  for (const point of shown) drawName(context, scene, point, shown);
}

/** Small hollow marks for the loupe, where what lies under them matters most. */
export function drawPlainMarks(context, scene, toScreen) {
  scene.keypoints.forEach((name, index) => {
    const xy = scene.points[name];
    if (!xy) return;
    const [x, y] = toScreen(xy);
    cased(context, shapePath(index, x, y, 9), colourOf(index), 1.5);
    dot(context, [x, y], colourOf(index));
  });
}

function drawSkeleton(context, scene, shown) {
  const at = new Map(shown.map((point) => [point.index, point.at]));
  for (const [i, j] of scene.skeleton) {
    if (at.has(i) && at.has(j)) cased(context, line(at.get(i), at.get(j)), "rgba(235,235,235,0.85)", 1.5);
  }
}

/** The vectors that the angle compares, where both of their points are placed; of the whole pieces of the chain. */
function endVectors({ view, points, definition }) {
  const chain = definition.points.map((name) => points[name] && view.toScreen(points[name]));
  const start = definition.name === "chord" ? 1 : chain.length - 2;
  return [
    { from: chain[0], to: chain[1], colour: FIXED_END },
    { from: chain[start], to: chain.at(-1), colour: MOVING_END },
  ].filter(({ from, to }) => from && to && Math.hypot(to[0] - from[0], to[1] - from[1]) > 1);
}

/** From point to point, stopping short of the marks so that they stay free. */
function drawArrow(context, { from, to, colour }) {
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  const along = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
  const clear = Math.min(RADIUS_PX + 3, length / 4);
  const at = (s, side = 0) => [from[0] + s * along[0] - side * along[1], from[1] + s * along[1] + side * along[0]];
  const tip = length - clear;
  const head = Math.min(11, length / 3);
  const shaft = line(at(clear), at(tip - head + 1));
  const arrowhead = new Path2D();
  for (const corner of [at(tip), at(tip - head, 0.42 * head), at(tip - head, -0.42 * head)]) arrowhead.lineTo(...corner);
  arrowhead.closePath();
  cased(context, arrowhead, colour, 1);
  cased(context, shaft, colour, 2.5);
  context.fillStyle = colour;
  context.fill(arrowhead);
}

/** At the moving end: the arc from the fixed end's direction (dashed) to the moving end's. */
function drawAngle(context, scene, [base, tip], shown) {
  const sweep = (scene.definition.sign * scene.angleDeg * Math.PI) / 180;
  const end = Math.atan2(tip.to[1] - tip.from[1], tip.to[0] - tip.from[0]);
  // Backwards from the moving end: chord and arc-fit measure from a direction that no drawn vector shows.
  const start = end - sweep;
  const length = Math.min(
    Math.hypot(base.to[0] - base.from[0], base.to[1] - base.from[1]),
    Math.hypot(tip.to[0] - tip.from[0], tip.to[1] - tip.from[1]),
  );
  const radius = Math.min(Math.max(0.62 * length, 26), 60);
  const [x, y] = tip.from;
  const reach = radius + 14;
  const dashed = line([x, y], [x + reach * Math.cos(start), y + reach * Math.sin(start)]);
  cased(context, dashed, FIXED_END, 1.5, [5, 4]);
  const arc = new Path2D();
  arc.arc(x, y, radius, start, end, sweep < 0);
  const fan = new Path2D(arc);
  fan.lineTo(x, y);
  context.globalAlpha = 0.16;
  context.fillStyle = ANGLE;
  if (Math.abs(sweep) < 2 * Math.PI) context.fill(fan);
  context.globalAlpha = 1;
  cased(context, arc, ANGLE, 2);

  const text = formatAngle(scene.angleDeg, 1);
  const narrow = Math.abs(sweep) < 0.9;
  const wanted = narrow ? start + sweep / 2 - (sweep < 0 ? -1 : 1) * (Math.PI / 2) : start + sweep / 2;
  const clear = narrow ? 34 : radius + 30;
  const at = freePlace([x, y], wanted, clear, shown, scene.view.screen);
  context.font = NUMBER;
  context.textAlign = "center";
  context.textBaseline = "middle";
  letters(context, text, at, ANGLE);
}

function freePlace([x, y], wanted, clear, shown, screen) {
  let best = [x, y];
  let leastCost = Infinity;
  for (const step of [0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6]) {
    const turn = wanted + (step * Math.PI) / 6;
    const at = [x + clear * Math.cos(turn), y + clear * Math.sin(turn)];
    let cost = 0.25 * Math.abs(step);
    if (at[0] < 36 || at[1] < 16 || at[0] > screen.width - 36 || at[1] > screen.height - 16) cost += 5;
    for (const point of shown) {
      if (Math.abs(point.at[0] - at[0]) < 46 && Math.abs(point.at[1] - at[1]) < 24) cost += 1;
    }
    if (cost < leastCost) [best, leastCost] = [at, cost];
  }
  return best;
}

function drawPoint(context, scene, { name, index, at }) {
  const [x, y] = at;
  const selected = name === scene.selected;
  if (selected) cased(context, circle(at, RADIUS_PX + 6), "#ffffff", 1.5, [3, 3]);
  cased(context, shapePath(index, x, y, RADIUS_PX), colourOf(index), 2);
  dot(context, at, colourOf(index));
}

/** Outside of the figure, away from the other points. */
function drawName(context, scene, { name, index, at }, shown) {
  const others = shown.filter((point) => point.index !== index);
  const mean = (axis) => others.reduce((sum, point) => sum + point.at[axis], 0) / others.length;
  let [dx, dy] = others.length ? [at[0] - mean(0), at[1] - mean(1)] : [1, -1];
  const length = Math.hypot(dx, dy) || 1;
  [dx, dy] = [dx / length, dy / length];
  context.font = LETTERS;
  context.textAlign = dx > 0.35 ? "left" : dx < -0.35 ? "right" : "center";
  context.textBaseline = "middle";
  letters(context, name, [at[0] + dx * (RADIUS_PX + 9), at[1] + dy * (RADIUS_PX + 11)], colourOf(index));
}

/** The points suggested by the network or the neighbouring labels, and the label's distance where it disagrees. */
function drawSuggestions(context, scene) {
  scene.keypoints.forEach((name, index) => {
    const suggestion = scene.suggestions[name];
    if (!suggestion) return;
    const at = scene.view.toScreen(suggestion.xy);
    const label = scene.points[name];
    const disagreement = scene.disagreements[name];
    if (label && !disagreement) return; // they agree: nothing to draw
    const colour = disagreement ? DISAGREEMENT : colourOf(index);
    if (disagreement) cased(context, line(scene.view.toScreen(label), at), DISAGREEMENT, 2);
    context.globalAlpha = 0.85;
    cased(context, shapePath(index, at[0], at[1], RADIUS_PX), colour, 1.5, [3.5, 2.5]);
    if (suggestion.sd_px !== null && suggestion.sd_px * scene.view.scale > RADIUS_PX) {
      cased(context, circle(at, suggestion.sd_px * scene.view.scale), colour, 1, [2, 3]);
    }
    context.globalAlpha = 1;
    if (disagreement) {
      context.font = LETTERS;
      context.textAlign = "left";
      context.textBaseline = "middle";
      letters(context, `${disagreement.toFixed(1)} px`, [at[0] + RADIUS_PX + 6, at[1]], DISAGREEMENT);
    }
  });
}

function drawCrosshair(context, { view, cursor, aimed }) {
  const [x, y] = view.toScreen(cursor);
  const gap = aimed ? 5 : 14;
  const { width, height } = view.screen;
  const hairs = new Path2D();
  for (const [from, to] of [
    [[0, y], [x - gap, y]],
    [[x + gap, y], [width, y]],
    [[x, 0], [x, y - gap]],
    [[x, y + gap], [x, height]],
  ]) {
    hairs.moveTo(...from);
    hairs.lineTo(...to);
  }
  context.lineWidth = 1;
  context.strokeStyle = "rgba(0,0,0,0.35)";
  context.stroke(hairs);
  context.setLineDash([4, 4]);
  context.strokeStyle = aimed ? "rgba(255,255,255,0.9)" : "rgba(255,255,255,0.5)";
  context.stroke(hairs);
  context.setLineDash([]);
}

/** A line with a dark casing: it reads on every background. */
function cased(context, path, colour, width, dashes = []) {
  context.lineCap = "round";
  context.lineJoin = "round";
  context.setLineDash(dashes);
  context.strokeStyle = "rgba(16,18,24,0.65)";
  context.lineWidth = width + 2.5;
  context.stroke(path);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke(path);
  context.setLineDash([]);
}

function dot(context, at, colour) {
  context.fillStyle = DARK;
  context.fill(circle(at, 2));
  context.fillStyle = colour;
  context.fill(circle(at, 1.25));
}

function letters(context, text, [x, y], colour) {
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = "rgba(16,18,24,0.75)";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

function line(from, to) {
  const path = new Path2D();
  path.moveTo(...from);
  path.lineTo(...to);
  return path;
}

function circle([x, y], radius) {
  const path = new Path2D();
  path.arc(x, y, radius, 0, 2 * Math.PI);
  return path;
}

/** Degrees with a true minus sign. */
export function formatAngle(angleDeg, digits) {
  return `${angleDeg.toFixed(digits).replace("-", "\u2212")}°`;
}
