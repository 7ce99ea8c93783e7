// Cache of decoded images: the ones shown last and the ones needed next, within a bounded memory.

const BUDGET_BYTES = 400e6; // a dozen 4K frames
const LEAST_KEPT = 3;
// Labels belong to the pixels, whatever orientation or colour profile the file claims.
const AS_STORED = { imageOrientation: "none", colorSpaceConversion: "none", premultiplyAlpha: "none" };

export class ImageCache {
  #entries = new Map(); // address -> {promise, bytes, bitmap}, the least recently used first
  #wanted = [];
  #prefetching = false;

  /** The image at an address, as an ImageBitmap. */
  get(address) {
    let entry = this.#entries.get(address);
    if (entry) this.#entries.delete(address);
    else entry = this.#load(address);
    this.#entries.set(address, entry);
    return entry.promise;
  }

  /** Decode these, one at a time, in this order, while there is nothing else to do. */
  async prefetch(addresses) {
    this.#wanted = addresses.filter((address) => !this.#entries.has(address));
    if (this.#prefetching) return;
    this.#prefetching = true;
    while (this.#wanted.length) await this.get(this.#wanted.shift()).catch(() => {});
    this.#prefetching = false;
  }

  #load(address) {
    const entry = { promise: null, bytes: 0, bitmap: null };
    entry.promise = decoded(address).then(
      (bitmap) => {
        entry.bitmap = bitmap;
        entry.bytes = 4 * bitmap.width * bitmap.height;
        this.#evict();
        return bitmap;
      },
      (error) => {
        this.#entries.delete(address);
        throw error;
      },
    );
    return entry;
  }

  #evict() {
    let bytes = 0;
    for (const entry of this.#entries.values()) bytes += entry.bytes;
    // Not closed: the oldest may still be on the screen. The browser frees an image that nothing refers to.
    for (const [address, entry] of this.#entries) {
      if (bytes <= BUDGET_BYTES || this.#entries.size <= LEAST_KEPT) return;
      bytes -= entry.bytes;
      this.#entries.delete(address);
    }
  }
}

async function decoded(address) {
  const response = await fetch(address);
  if (!response.ok) throw new Error(`the image is not there (${response.status})`);
  const blob = await response.blob();
  try {
    return await createImageBitmap(blob, AS_STORED);
  } catch (error) {
    // A browser that does not know one of the options.
    if (error instanceof TypeError) return createImageBitmap(blob);
    throw error;
  }
}
