// The scene: everything that is drawn on the image at the moment, from the project, the open frame and the pointer.

import { bendingAngleDeg, definitionOf } from "./angle.js";

// A label this far from the network's prediction is worth a second look; on a frame of another size, in
// proportion. Where the network knows how sure it is, three standard deviations count too.
const DISAGREEMENT_PX = 4;
const DISAGREEMENT_AT_DIAGONAL_PX = 800;
const DISAGREEMENT_SD = 3;

/** project: as the server gives it; the rest: the parts of the page that the scene depends on. */
export function makeScene(project, { open, view, pointer, options }) {
  const definition = definitionOf(project, open.frame);
  const suggestions = open.isRepeat ? {} : (open.frame?.suggestions ?? {});
  const dragged = pointer.dragged;
  const cursor = options.keyboardCursor ?? pointer.over;
  const loupeAt = dragged ? open.points[dragged] : options.keyboardCursor ?? pointer.over;
  return {
    view,
    keypoints: project.keypoints,
    points: open.points,
    definition,
    skeleton: project.skeleton,
    angleDeg: open.isRepeat ? null : bendingAngleDeg(open.points, definition),
    selected: open.selected,
    suggestions,
    suggestionsShown: options.suggestions,
    disagreements: disagreements(open, view.image),
    cursor: open.frame && !pointer.panning ? cursor : null,
    aimed: Boolean(options.keyboardCursor),
    loupe: options.loupe && !pointer.panning ? loupeAt : null,
  };
}

/** {keypoint: distance px} of the labels that the network disagrees with. */
export function disagreements(open, { width, height }) {
  const found = {};
  if (open.frame?.suggestion_source !== "model" || open.isRepeat) return found;
  const least = DISAGREEMENT_PX * Math.max(1, Math.hypot(width, height) / DISAGREEMENT_AT_DIAGONAL_PX);
  for (const [name, suggestion] of Object.entries(open.frame.suggestions)) {
    const label = open.points[name];
    if (!label) continue;
    const distance = Math.hypot(label[0] - suggestion.xy[0], label[1] - suggestion.xy[1]);
    if (distance > Math.max(least, DISAGREEMENT_SD * (suggestion.sd_px ?? 0))) found[name] = distance;
  }
  return found;
}
