// Somebody else changed the frame in the meantime: both versions side by side, and a choice. Nothing is overwritten
// and nothing is thrown away before it is made.

import { byId, element } from "./elements.js";
import { drawPlainMarks } from "./marks.js";

const PREVIEW_WH = [300, 210];

/** Resolves "mine" or "theirs". mine: the unsent edit's body; theirs: a frame object. */
export function chooseVersion({ row, mine, theirs, keypoints, bitmap }) {
  const dialog = byId("conflict");
  return new Promise((resolve) => {
    const choose = (choice) => {
      dialog.close();
      resolve(choice);
    };
    const region = regionOf([mine.points, theirs.points], bitmap);
    const version = (title, frame, words, choice) =>
      element(
        "section",
        { class: "version" },
        element("h3", {}, title),
        preview(frame.points, keypoints, bitmap, region),
        element("p", { class: "fine" }, facts(frame)),
        element("button", { type: "button", class: "wide", id: `choose-${choice}`, onclick: () => choose(choice) }, words),
      );
    dialog.replaceChildren(
      element("h2", { id: "conflict-title" }, "This frame was changed elsewhere"),
      element(
        "p",
        {},
        `${row?.video ?? ""} · frame ${row?.frame ?? row?.image ?? ""}: while you worked on it, another tab or person saved it too. `,
        "Which version shall stay?",
      ),
      element(
        "div",
        { class: "versions" },
        version("Yours", mine, "Keep mine", "mine"),
        version("Theirs, saved", theirs, "Take theirs", "theirs"),
      ),
      element("ul", { class: "differences fine" }, ...differences(mine, theirs, keypoints).map((words) => element("li", {}, words))),
    );
    // Escape would leave it open which one counts.
    dialog.oncancel = (event) => event.preventDefault();
    dialog.showModal();
    byId("choose-theirs").focus();
  });
}

function facts(frame) {
  const placed = Object.values(frame.points).filter(Boolean).length;
  const words = [`${placed} ${placed === 1 ? "point" : "points"}`];
  if (frame.flagged) words.push("flagged");
  if (frame.skipped) words.push("skipped");
  if (frame.note) words.push(`“${frame.note}”`);
  return words.join(" · ");
}

function differences(mine, theirs, keypoints) {
  const words = [];
  for (const name of keypoints) {
    const [a, b] = [mine.points[name], theirs.points[name]];
    if (a && b) {
      const distance = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (distance > 0.005) words.push(`${name}: ${distance.toFixed(2)} px apart`);
    } else if (a || b) words.push(`${name}: placed only in ${a ? "yours" : "theirs"}`);
  }
  if (mine.note !== undefined && mine.note !== theirs.note) words.push("the notes differ");
  return words;
}

/** The part of the picture that holds all points of both versions, with the preview's proportions. */
function regionOf(versions, bitmap) {
  const all = versions.flatMap((points) => Object.values(points).filter(Boolean));
  if (!all.length || !bitmap) return { x: 0, y: 0, scale: bitmap ? PREVIEW_WH[0] / bitmap.width : 1 };
  const [xs, ys] = [all.map(([x]) => x), all.map(([, y]) => y)];
  const centre = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  const width = Math.max(Math.max(...xs) - Math.min(...xs) + 60, ((Math.max(...ys) - Math.min(...ys) + 60) * PREVIEW_WH[0]) / PREVIEW_WH[1], 120);
  const scale = PREVIEW_WH[0] / width;
  return { x: centre[0] - PREVIEW_WH[0] / 2 / scale, y: centre[1] - PREVIEW_WH[1] / 2 / scale, scale };
}

function preview(points, keypoints, bitmap, { x, y, scale }) {
  const ratio = devicePixelRatio || 1;
  const canvas = element("canvas", { class: "preview", width: PREVIEW_WH[0] * ratio, height: PREVIEW_WH[1] * ratio });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  if (bitmap) {
    context.drawImage(bitmap, (-0.5 - x) * scale, (-0.5 - y) * scale, bitmap.width * scale, bitmap.height * scale);
  }
  drawPlainMarks(context, { keypoints, points }, (xy) => [(xy[0] - x) * scale, (xy[1] - y) * scale]);
  return canvas;
}
