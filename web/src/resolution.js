// How many of the screen's pixels are drawn, so that frames keep up with the screen.

/** A frame of a screen that shows sixty a second. */
const TARGET_MS = 1000 / 60;
/** The median of so many frames is judged: one slow frame is no reason. */
const WINDOW = 9;
/** After so many good frames in a row more pixels are tried. */
const GOOD_FRAMES = 90;
/** Fewest pixels along a side, as a share of all: below this a picture is mush. */
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

  /** Forgets measured times: the frames around a pause, a new size or a new scene say nothing. */
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
      // Fewer pixels did not help: time goes elsewhere, and pixels are not to pay for it.
      this.#scale = this.#before.scale;
      this.#before = null;
      this.#hold = 16 * GOOD_FRAMES;
    } else if (this.#scale > MIN_SCALE) {
      this.#before = { median, scale: this.#scale };
      // Time goes with the pixels, the square of the scale; a step too far would flicker.
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
