// Decides how many of the screen's pixels are drawn, so that frames keep up with the screen.

/** Milliseconds of a frame at sixty frames a second. */
const TARGET_MS = 1000 / 60;
/** Number of frames whose median time decides: one slow frame is no reason to draw fewer pixels. */
const WINDOW = 9;
/** Number of consecutive frames in time after which more pixels are tried. */
const GOOD_FRAMES = 90;
/** Least share of the pixels along a side: with fewer, a picture shows nothing. */
const MIN_SCALE = 0.35;

export class AdaptiveResolution {
  #scale = 1;
  #intervals = [];
  #good = 0;
  #wait = GOOD_FRAMES;
  /** Scale and median before the last lowering, to see whether it helped. */
  #before = null;
  #raised = false;
  #hold = 0;

  /** Share of the pixels along each side that is drawn. */
  get scale() {
    return this.#scale;
  }

  /** Drops the measured times: frames around a pause, a new size or a new scene do not measure the cost of pixels. */
  forget() {
    this.#intervals = [];
    this.#good = 0;
  }

  /**
   * Takes the time from one frame to the next, and changes `scale` now and then.
   * @param {number} milliseconds
   */
  frame(milliseconds) {
    if (this.#hold > 0) {
      this.#hold -= 1;
      return;
    }
    this.#intervals.push(milliseconds);
    if (this.#intervals.length < WINDOW) return;
    const median = [...this.#intervals].sort((a, b) => a - b)[WINDOW >> 1];
    this.#intervals = [];
    if (median > 1.25 * TARGET_MS) this.#lower(median);
    else this.#keep();
  }

  #lower(median) {
    if (this.#raised) this.#wait = Math.min(16 * GOOD_FRAMES, 2 * this.#wait); // it was too much: try less often
    this.#raised = false;
    this.#good = 0;
    if (this.#before && median > 0.9 * this.#before.median) {
      // Fewer pixels did not help: something else takes the time, so the scale goes back.
      this.#scale = this.#before.scale;
      this.#before = null;
      this.#hold = 16 * GOOD_FRAMES;
    } else if (this.#scale > MIN_SCALE) {
      this.#before = { median, scale: this.#scale };
      // Time grows with the number of pixels, the square of the scale. Too large a step would make the scale oscillate.
      this.#scale = Math.max(MIN_SCALE, this.#scale * Math.max(0.6, Math.sqrt(TARGET_MS / median)));
    }
  }

  #keep() {
    this.#before = null;
    this.#good += WINDOW;
    if (this.#good < this.#wait || this.#scale === 1) return;
    this.#good = 0;
    this.#raised = true;
    this.#scale = Math.min(1, this.#scale * 1.15);
  }
}
