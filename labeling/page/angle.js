// The bending angle of one frame, in four definitions. The formulas are those of tracker/angle.py, which says
// what they mean; a test holds the two side by side. The circle fit is in arc_fit.js.

import { arcAngle } from "./arc_fit.js";

const COINCIDENT_PX = 1e-3;

/** The project's definition with the sign of the actuator that a frame shows; frame may be null. */
export function definitionOf(project, frame) {
  return { ...project.definition, sign: project.signs[frame?.actuator] ?? project.definition.sign };
}

/** Degrees, or null where a point of the chain is missing or two neighbours coincide.
 *  points: {keypoint: [x, y]|null}; definition: {name, points, sign}. */
export function bendingAngleDeg(points, definition) {
  let chain = definition.points.map((name) => points[name] ?? null);
  if (chain.includes(null)) return null;
  if (definition.name === "chord") chain = [chain[0], chain[1], chain.at(-1)];
  for (let i = 1; i < chain.length; i++) {
    if (Math.hypot(chain[i][0] - chain[i - 1][0], chain[i][1] - chain[i - 1][1]) < COINCIDENT_PX) return null;
  }
  const angle = definition.name === "arc-fit" ? arcAngle(chain) : sumOfTurns(chain);
  const factor = definition.name === "chord" ? 2 : 1;
  return (definition.sign * factor * angle * 180) / Math.PI;
}

/** Lengths in px of the fixed and the moving end's vector, null where unknown. The chord ends in its chord. */
export function endVectorsPx(points, definition) {
  const chain = definition.points.map((name) => points[name] ?? null);
  const last = definition.name === "chord" ? 1 : chain.length - 2;
  const length = (a, b) => (a && b ? Math.hypot(b[0] - a[0], b[1] - a[1]) : null);
  return [length(chain[0], chain[1]), length(chain[last], chain.at(-1))];
}

function sumOfTurns(chain) {
  let sum = 0;
  for (let i = 2; i < chain.length; i++) {
    const [ax, ay] = [chain[i - 1][0] - chain[i - 2][0], chain[i - 1][1] - chain[i - 2][1]];
    const [bx, by] = [chain[i][0] - chain[i - 1][0], chain[i][1] - chain[i - 1][1]];
    const turn = Math.atan2(ax * by - ay * bx, ax * bx + ay * by);
    sum += turn === -Math.PI ? Math.PI : turn; // a turn lies in (-180, 180]
  }
  return sum;
}
