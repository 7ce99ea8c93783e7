// Text about the open frame: the angle, the hint, the pointer's position, the panel on the right.

import { bendingAngleDeg, definitionOf, endVectorsPx } from "./angle.js";
import { byId } from "./elements.js";
import { formatAngle } from "./marks.js";
import { swatch } from "./palette.js";

const DEFINITION_TEXT = {
  "two-vector": "turn from the first two points to the last two",
  "three-point": "turn at the middle point",
  chord: "twice the turn from base to chord",
  "arc-fit": "turn of the fitted arc",
};

// Where the points of a new project belong; names of one's own are known to who chose them.
const PLACES = { base_1: "fixed end, first", base_2: "fixed end, second", tip_1: "moving end, first", tip_2: "moving end, last" };

function placeOf(project, keypoint) {
  const usual = Object.keys(PLACES);
  return project.keypoints.length === usual.length && usual.every((name, i) => project.keypoints[i] === name) ? PLACES[keypoint] : null;
}

export function showAngle(project, open) {
  const definition = definitionOf(project, open.frame);
  byId("angle-name").title = DEFINITION_TEXT[definition.name] ?? "";
  byId("angle-name").textContent = open.isRepeat ? "Blind repeat" : "Bending angle";
  const angle = open.isRepeat ? null : bendingAngleDeg(open.points, definition);
  byId("angle").textContent = angle === null ? "–" : formatAngle(angle, 2);
  byId("angle").classList.toggle("unknown", angle === null);
  const ends = open.isRepeat ? [null, null] : endVectorsPx(open.points, definition);
  const lengths = ends.filter((length) => length !== null).map((length) => length.toFixed(1));
  // Always one line, so that what is below stays where it is.
  let text = definition.name;
  if (open.isRepeat) text = "earlier labels are hidden";
  else if (lengths.length) text = `${lengths.length > 1 ? "ends" : "end"} ${lengths.join(" and ")} px`;
  byId("ends").textContent = text;
  byId("ends").title = open.isRepeat ? "" : `${definition.name}: ${DEFINITION_TEXT[definition.name] ?? ""}`;
}

export function showHint(project, open, aimed) {
  const hint = byId("hint");
  const target = open.frame && !open.locked ? open.target : null;
  const parts = [];
  if (!open.frame) parts.push("");
  else if (open.skipped) parts.push("Skipped: not used as a label. K undoes this.");
  else if (target) {
    const marks = document.createElement("strong");
    marks.append(swatch(project.keypoints.indexOf(target), 15), target);
    parts.push(aimed ? "Enter places " : "Click to place ", marks, aimed ? " here" : "");
    const place = placeOf(project, target);
    if (place) parts.push(`: ${place}`);
  } else if (open.isRepeat) parts.push("All placed. Enter saves and goes on.");
  else parts.push(`All points are set. ${project.can_finish ? "Measure goes on." : "N: next to label."}`);
  const text = parts.map((part) => part.textContent ?? part).join("");
  if (hint.dataset.text === text) return;
  hint.dataset.text = text;
  hint.replaceChildren(...parts);
}

export function showPosition(view, cursor) {
  byId("zoom").textContent = `${Math.round(100 * view.scale)} %`;
  const inside = cursor && view.contains(cursor);
  byId("position").textContent = inside ? `${cursor[0].toFixed(1)}, ${cursor[1].toFixed(1)}` : "";
}

export function showFrameState(open) {
  byId("flag").setAttribute("aria-pressed", open.flagged);
  byId("skip").setAttribute("aria-pressed", open.skipped);
  const note = byId("note");
  if (document.activeElement !== note && note.value !== open.note) note.value = open.note;
  const usable = Boolean(open.frame) && !open.isRepeat;
  for (const id of ["flag", "skip", "note"]) byId(id).disabled = !usable;
  byId("copy-previous").disabled = !usable || !open.frame.previous;
  byId("accept-suggestions").disabled = !usable || !Object.keys(open.frame.suggestions ?? {}).length;
  byId("not-visible").disabled = !usable;
  byId("not-visible").setAttribute("aria-pressed", usable && open.notVisible.has(open.selected));
  const source = usable ? open.frame.suggestion_source : null;
  byId("accept-label").textContent = { model: "Accept network's", neighbours: "Accept suggestions" }[source] ?? "Accept suggestions";
  byId("accept-suggestions").title =
    source === "model"
      ? "Take the network's points for the missing ones (G)"
      : "Take the points interpolated from the neighbouring labelled frames for the missing ones (G)";
}
