// Conflict dialog: someone else changed the frame in the meantime. Both versions are shown next to each other; nothing
// is overwritten or dropped before the user has chosen.

import { byId, element } from "./elements.js";
import { drawPlainMarks } from "./marks.js";

const PREVIEW_WH = [300, 210];
const LEAST_SHOWN_PX = 48;
const AROUND_PX = 24;

/** Resolves "mine" or "theirs". mine: the unsent edit's body; theirs: a frame object. */
export function chooseVersion({ row, mine, theirs, keypoints, bitmap }) {
  const dialog = byId("conflict");
  return new Promise((resolve) => {
    const choose = (choice) => {
      dialog.close();
      resolve(choice);
    };
    const region = regionOf(mine.points, theirs.points, bitmap);
    const version = (title, frame, text, choice) =>
      element(
        "section",
        { class: "version" },
        element("h3", {}, title),
        preview(frame.points, frame === mine ? theirs.points : mine.points, keypoints, bitmap, region),
        element("p", { class: "fine" }, facts(frame)),
        element("button", { type: "button", class: "wide", id: `choose-${choice}`, onclick: () => choose(choice) }, text),
      );
    dialog.replaceChildren(
      element("h2", { id: "conflict-title" }, "This frame was changed elsewhere"),
      element(
        "p",
        {},
        `${row?.video ?? ""} · frame ${row?.frame ?? row?.image ?? ""}: while you worked on it, another tab or person saved it too. `,
        "Which version do you want to keep?",
      ),
      element(
        "div",
        { class: "versions" },
        version("Yours", mine, "Keep mine", "mine"),
        version("Theirs, saved", theirs, "Take theirs", "theirs"),
      ),
      element("ul", { class: "differences fine" }, ...differences(mine, theirs, keypoints).map((text) => element("li", {}, text))),
    );
    // Escape would leave the conflict unresolved.
    dialog.oncancel = (event) => event.preventDefault();
    dialog.showModal();
    byId("choose-theirs").focus();
  });
}

function facts(frame) {
  const placed = Object.values(frame.points).filter(Boolean).length;
  const parts = [`${placed} ${placed === 1 ? "point" : "points"}`];
  if (frame.flagged) parts.push("flagged");
  if (frame.skipped) parts.push("skipped");
  if (frame.note) parts.push(`“${frame.note}”`);
  return parts.join(" · ");
}

function differences(mine, theirs, keypoints) {
  const found = [];
  for (const name of keypoints) {
    const [a, b] = [mine.points[name], theirs.points[name]];
    if (a && b) {
      const distance = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (distance > 0.005) found.push(`${name}: ${distance.toFixed(2)} px apart`);
    } else if (a || b) found.push(`${name}: placed only in ${a ? "yours" : "theirs"}`);
  }
  if (mine.note !== undefined && mine.note !== theirs.note) found.push("the notes differ");
  return found;
}

/** The part of the image in which the versions differ, with the preview's proportions. */
function regionOf(mine, theirs, bitmap) {
  const both = (name) => [mine[name], theirs[name]].filter(Boolean);
  const differing = Object.keys(theirs).filter((name) => String(mine[name]) !== String(theirs[name]));
  const points = (differing.length ? differing : Object.keys(theirs)).flatMap(both);
  const [width, height] = PREVIEW_WH;
  if (!points.length || !bitmap) return { x: 0, y: 0, scale: bitmap ? width / bitmap.width : 1 };
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const shown = Math.max(right - left + 2 * AROUND_PX, ((bottom - top + 2 * AROUND_PX) * width) / height, LEAST_SHOWN_PX);
  const scale = width / shown;
  return { x: (left + right) / 2 - width / 2 / scale, y: (top + bottom) / 2 - height / 2 / scale, scale };
}

/** One version's points, and small dots where the other has them. */
function preview(points, others, keypoints, bitmap, { x, y, scale }) {
  const ratio = devicePixelRatio || 1;
  const canvas = element("canvas", { class: "preview", width: PREVIEW_WH[0] * ratio, height: PREVIEW_WH[1] * ratio });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  if (bitmap) {
    context.drawImage(bitmap, (-0.5 - x) * scale, (-0.5 - y) * scale, bitmap.width * scale, bitmap.height * scale);
  }
  const toPreview = (xy) => [(xy[0] - x) * scale, (xy[1] - y) * scale];
  context.fillStyle = "#fff";
  for (const xy of Object.values(others).filter(Boolean)) {
    context.beginPath();
    context.arc(...toPreview(xy), 2.5, 0, 2 * Math.PI);
    context.fill();
  }
  drawPlainMarks(context, { keypoints, points }, toPreview);
  return canvas;
}
