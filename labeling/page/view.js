// The transform between image and screen: zoom, pan, fit. Nothing is drawn here.
//
// Image positions have (0, 0) at the centre of the top-left pixel, so an image drawn with its corner at
// (left, top) shows position p at (p + 0.5) * scale + (left, top). Screen positions are CSS px in the canvas.

const MAX_SCALE = 64;
const MARGIN_PX = 16;
const KEEP_VISIBLE_PX = 80;

export class View extends EventTarget {
  scale = 1;
  left = 0;
  top = 0;
  fitted = true;
  #image = { width: 1, height: 1 };
  #screen = { width: 1, height: 1 };

  get image() {
    return this.#image;
  }

  get screen() {
    return this.#screen;
  }

  /** An image of the same size keeps zoom and place, so that frames can be compared. */
  setImageSize(width, height) {
    const same = this.#image.width === width && this.#image.height === height;
    this.#image = { width, height };
    if (!same || this.fitted) this.fit();
    else this.#changed();
  }

  setScreen(width, height) {
    const [dx, dy] = [(width - this.#screen.width) / 2, (height - this.#screen.height) / 2];
    this.#screen = { width, height };
    if (this.fitted) this.fit();
    else this.pan(dx, dy);
  }

  fit() {
    this.scale = this.#fittingScale();
    this.left = (this.#screen.width - this.#image.width * this.scale) / 2;
    this.top = (this.#screen.height - this.#image.height * this.scale) / 2;
    this.fitted = true;
    this.#changed();
  }

  /** Zoom, with what lies at a screen position staying there. */
  zoomAt([x, y], factor) {
    const least = Math.min(this.#fittingScale(), 1) / 2;
    const next = Math.min(Math.max(this.scale * factor, least), MAX_SCALE);
    this.left = x - ((x - this.left) * next) / this.scale;
    this.top = y - ((y - this.top) * next) / this.scale;
    this.scale = next;
    this.fitted = false;
    this.#keepVisible();
    this.#changed();
  }

  pan(dx, dy) {
    this.left += dx;
    this.top += dy;
    this.fitted = false;
    this.#keepVisible();
    this.#changed();
  }

  /** Pan as little as it takes to bring an image position well inside the screen. */
  reveal(position) {
    const [x, y] = this.toScreen(position);
    const { width, height } = this.#screen;
    const [mx, my] = [Math.min(60, width / 4), Math.min(60, height / 4)];
    const dx = Math.min(Math.max(x, mx), width - mx) - x;
    const dy = Math.min(Math.max(y, my), height - my) - y;
    if (dx || dy) this.pan(dx, dy);
  }

  toScreen([x, y]) {
    return [(x + 0.5) * this.scale + this.left, (y + 0.5) * this.scale + this.top];
  }

  toImage([x, y]) {
    return [(x - this.left) / this.scale - 0.5, (y - this.top) / this.scale - 0.5];
  }

  contains([x, y]) {
    return x >= -0.5 && y >= -0.5 && x <= this.#image.width - 0.5 && y <= this.#image.height - 0.5;
  }

  clamped([x, y]) {
    return [
      Math.min(Math.max(x, -0.5), this.#image.width - 0.5),
      Math.min(Math.max(y, -0.5), this.#image.height - 0.5),
    ];
  }

  #fittingScale() {
    const room = (side) => Math.max(1, this.#screen[side] - 2 * MARGIN_PX) / this.#image[side];
    return Math.min(room("width"), room("height"), MAX_SCALE);
  }

  #keepVisible() {
    const clamp = (start, size, room) => {
      const keep = Math.min(KEEP_VISIBLE_PX, size, room);
      return Math.min(Math.max(start, keep - size), room - keep);
    };
    this.left = clamp(this.left, this.#image.width * this.scale, this.#screen.width);
    this.top = clamp(this.top, this.#image.height * this.scale, this.#screen.height);
  }

  #changed() {
    this.dispatchEvent(new Event("change"));
  }
}
