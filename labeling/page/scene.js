// What there is to see on the picture right now, put together from the project, the open frame and the pointer.

import { bendingAngleDeg } from "./angle.js";

// A label this far from the network's prediction is worth a second look; on a frame of another size, in
// proportion. Where the network knows how sure it is, three standard deviations count too.
const DOUBT_PX = 4;
const DOUBT_AT_DIAGONAL_PX = 800;
const DOUBT_SD = 3;

/** project: as the server gives it; the rest: the parts of the page that know what is to be seen. */
export function makeScene(project, { open, view, pointer, options }) {
  const definition = project.definition;
  const ghosts = open.isRepeat ? {} : (open.frame?.ghosts ?? {});
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
    ghosts,
    ghostsShown: options.ghosts,
    doubts: doubts(open, view.picture),
    cursor: open.frame && !pointer.panning ? cursor : null,
    aimed: Boolean(options.keyboardCursor),
    loupe: options.loupe && !pointer.panning ? loupeAt : null,
  };
}

/** {keypoint: distance px} of the labels that the network disagrees with. */
export function doubts(open, { width, height }) {
  const found = {};
  if (open.frame?.ghost_source !== "model" || open.isRepeat) return found;
  const least = DOUBT_PX * Math.max(1, Math.hypot(width, height) / DOUBT_AT_DIAGONAL_PX);
  for (const [name, ghost] of Object.entries(open.frame.ghosts)) {
    const label = open.points[name];
    if (!label) continue;
    const distance = Math.hypot(label[0] - ghost.xy[0], label[1] - ghost.xy[1]);
    if (distance > Math.max(least, DOUBT_SD * (ghost.sd_px ?? 0))) found[name] = distance;
  }
  return found;
}
