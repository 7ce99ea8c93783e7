// The loupe: the pixels around a position, magnified, with a cross at the position. It is drawn next to the position
// and never covers it.

import { drawPlainMarks } from "./marks.js";

const SIZE_PX = 169; // odd: the cross lies on pixels of the screen
const BESIDE_PX = 28;
const TIMES = 4; // larger than on the screen
const LEAST_SCALE = 8;
const MOST_SCALE = 32;

/** scene.loupe: an image position, or null for no loupe. */
export function drawLoupe(frame, bitmap, scene) {
  const scale = Math.min(Math.max(TIMES * scene.view.scale, LEAST_SCALE), MOST_SCALE);
  // Of no use where the screen is as large already.
  const shown = Boolean(bitmap && scene.loupe && scene.view.scale < MOST_SCALE / 2);
  frame.hidden = !shown;
  if (!shown) return;
  place(frame, scene.view.toScreen(scene.loupe), scene.view.screen);

  const middle = SIZE_PX / 2;
  const [x, y] = scene.loupe;
  const toLoupe = ([px, py]) => [middle + (px - x) * scale, middle + (py - y) * scale];
  const [pixels, marks] = [...frame.querySelectorAll("canvas")].map(sized);
  const [left, top] = toLoupe([-0.5, -0.5]);
  pixels.imageSmoothingEnabled = false;
  pixels.drawImage(bitmap, left, top, bitmap.width * scale, bitmap.height * scale);
  drawPlainMarks(marks, scene, toLoupe);
  cross(marks, middle);
}

function place(frame, [x, y], screen) {
  const left = x + BESIDE_PX + SIZE_PX > screen.width ? x - BESIDE_PX - SIZE_PX : x + BESIDE_PX;
  const top = y - BESIDE_PX - SIZE_PX < 0 ? y + BESIDE_PX : y - BESIDE_PX - SIZE_PX;
  frame.style.transform = `translate(${Math.round(left)}px, ${Math.round(top)}px)`;
}

function sized(canvas) {
  const ratio = devicePixelRatio || 1;
  if (canvas.width !== Math.round(SIZE_PX * ratio)) canvas.width = canvas.height = Math.round(SIZE_PX * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, SIZE_PX, SIZE_PX);
  return context;
}

function cross(context, middle) {
  const path = new Path2D();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    path.moveTo(middle + 4 * dx, middle + 4 * dy);
    path.lineTo(middle + 22 * dx, middle + 22 * dy);
  }
  context.lineWidth = 3;
  context.strokeStyle = "rgba(0,0,0,0.6)";
  context.stroke(path);
  context.lineWidth = 1;
  context.strokeStyle = "#fff";
  context.stroke(path);
  context.fillStyle = "#fff";
  context.fillRect(middle - 0.5, middle - 0.5, 1, 1);
}
