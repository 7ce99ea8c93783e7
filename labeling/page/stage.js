// The canvases: the image, the marks on it, the loupe. Changed layers are drawn once per screen refresh.

import { drawLoupe } from "./loupe.js";
import { drawMarks } from "./marks.js";

// From this scale on pixels are drawn as squares; below it, a smoothed image shows edges better.
const SQUARE_PIXELS_SCALE = 8;

export class Stage {
  bitmap = null;
  #root;
  #image;
  #marks;
  #loupe;
  #view;
  #scene;
  #dirty = new Set();

  /** scene(): what there is to draw, see `makeScene`. */
  constructor(root, view, scene) {
    this.#root = root;
    this.#image = root.querySelector("#image");
    this.#marks = root.querySelector("#marks");
    this.#loupe = root.querySelector("#loupe");
    this.#view = view;
    this.#scene = scene;
    view.addEventListener("change", () => this.redraw("image", "marks"));
    new ResizeObserver(() => this.#resize()).observe(root);
  }

  show(bitmap) {
    this.bitmap = bitmap;
    this.#view.setImageSize(bitmap.width, bitmap.height);
    this.redraw("image", "marks");
  }

  clear() {
    this.bitmap = null;
    this.redraw("image", "marks");
  }

  /** Ask for "image", "marks" or both to be drawn again. */
  redraw(...layers) {
    if (!this.#dirty.size) requestAnimationFrame(() => this.#draw());
    for (const layer of layers) this.#dirty.add(layer);
  }

  #resize() {
    const { width, height } = this.#root.getBoundingClientRect();
    const ratio = devicePixelRatio || 1;
    for (const canvas of [this.#image, this.#marks]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    this.#view.setScreen(width, height);
    this.redraw("image", "marks");
  }

  #draw() {
    const dirty = this.#dirty;
    this.#dirty = new Set();
    const scene = this.#scene();
    if (dirty.has("image")) this.#drawImage();
    const context = cleared(this.#marks);
    if (this.bitmap) drawMarks(context, scene);
    drawLoupe(this.#loupe, this.bitmap, scene);
    // For assistive tools and tests: where the image lies.
    const { scale, left, top } = this.#view;
    Object.assign(this.#root.dataset, { scale, left, top });
  }

  #drawImage() {
    const context = cleared(this.#image);
    if (!this.bitmap) return;
    const { scale, left, top } = this.#view;
    const ratio = devicePixelRatio || 1;
    context.imageSmoothingEnabled = scale * ratio < SQUARE_PIXELS_SCALE;
    context.imageSmoothingQuality = "medium";
    context.translate(left, top);
    context.scale(scale, scale);
    context.drawImage(this.bitmap, 0, 0);
  }
}

/** The context of a canvas, empty, in CSS px. */
function cleared(canvas) {
  const context = canvas.getContext("2d");
  const ratio = devicePixelRatio || 1;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}
