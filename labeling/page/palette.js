// The mark of a keypoint: a colour of Okabe and Ito's palette, distinct with any colour vision, and a shape of
// its own. The fixed end is blue, the moving end orange, the angle yellow, disagreement red-orange, as in the overlay video.

export const FIXED_END = "#56b4e9";
export const MOVING_END = "#f5960a";
export const ANGLE = "#fae850";
export const DISAGREEMENT = "#ff5828";
export const DARK = "#101218";

const COLOURS = ["#56b4e9", "#2fc79b", "#f5960a", "#e28bbd", "#fae850", "#ff5828", "#4d9df0", "#d8d8d8"];

// Corners on the unit circle; the circle itself has none.
const SHAPES = [
  null,
  polygon(4, 45, 1.2),
  polygon(3, -90, 1.28),
  polygon(4, 0, 1.28),
  polygon(3, 90, 1.28),
  polygon(6, 0, 1.12),
  star(),
  polygon(5, -90, 1.16),
];

export function colourOf(index) {
  return COLOURS[index % COLOURS.length];
}

/** Path of keypoint `index`'s shape around (x, y), to be stroked or filled. */
export function shapePath(index, x, y, radius) {
  const path = new Path2D();
  // With more keypoints than shapes, the second round pairs them with other colours.
  const corners = SHAPES[(index + Math.floor(index / COLOURS.length)) % SHAPES.length];
  if (!corners) path.arc(x, y, radius, 0, 2 * Math.PI);
  else {
    for (const [dx, dy] of corners) path.lineTo(x + radius * dx, y + radius * dy);
    path.closePath();
  }
  return path;
}

/** A small canvas with the keypoint's mark, for lists. */
export function swatch(index, sizePx = 16) {
  const canvas = document.createElement("canvas");
  const scale = window.devicePixelRatio || 1;
  canvas.className = "swatch";
  canvas.width = canvas.height = Math.round(sizePx * scale);
  canvas.setAttribute("aria-hidden", "true");
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  const path = shapePath(index, sizePx / 2, sizePx / 2, sizePx * 0.33);
  context.fillStyle = colourOf(index);
  context.fill(path);
  context.strokeStyle = DARK;
  context.globalAlpha = 0.55;
  context.lineWidth = 1;
  context.stroke(path);
  return canvas;
}

function polygon(corners, startDeg, radius) {
  return Array.from({ length: corners }, (_, i) => {
    const turn = ((startDeg + (360 * i) / corners) * Math.PI) / 180;
    return [radius * Math.cos(turn), radius * Math.sin(turn)];
  });
}

function star() {
  return Array.from({ length: 10 }, (_, i) => {
    const turn = ((-90 + 36 * i) * Math.PI) / 180;
    const radius = i % 2 ? 0.62 : 1.35;
    return [radius * Math.cos(turn), radius * Math.sin(turn)];
  });
}
