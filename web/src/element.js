// <tcgs-player src="scene.tcgs"></tcgs-player>: the player as an element of a page of your own. docs/PLAYER.md
// describes it.

import { TcgsPlayer } from "./tcgs-player.js";

export { TcgsPlayer };

/** Events of the player, which the element forwards. */
const EVENTS = ["ready", "load", "error", "play", "pause", "timestep"];

// A constructed sheet, because a page's Content-Security-Policy may forbid <style>.
const STYLE = new CSSStyleSheet();
STYLE.replaceSync(`
  :host { display: block; aspect-ratio: 16 / 9; }
  :host([hidden]) { display: none; }
  iframe { display: block; width: 100%; height: 100%; border: 0; }
`);

/**
 * Attributes are those of the page's address, such as `src`, `controls="false"`, `autoplay="false"`, `theme="dark"`. A
 * changed `src` is opened. Methods are those of `player`.
 */
export class TcgsPlayerElement extends HTMLElement {
  static observedAttributes = ["src"];

  /** The player inside; null while the element is in no page. @type {TcgsPlayer | null} */
  player = null;

  constructor() {
    super();
    // With `delegatesFocus`, `focus()` of the element gives the keys to the player.
    this.attachShadow({ mode: "open", delegatesFocus: true }).adoptedStyleSheets = [STYLE];
  }

  connectedCallback() {
    const ours = [...this.attributes].filter(({ name }) => !["id", "class", "style", "title", "hidden"].includes(name));
    const params = Object.fromEntries(ours.map(({ name, value }) => [name, value]));
    this.player = new TcgsPlayer(/** @type {ShadowRoot} */ (this.shadowRoot), params);
    if (this.title) this.player.frame.title = this.title;
    for (const name of EVENTS) {
      this.player.addEventListener(name, (event) => {
        this.dispatchEvent(new CustomEvent(name, { detail: /** @type {CustomEvent} */ (event).detail }));
      });
    }
  }

  disconnectedCallback() {
    this.player?.remove();
    this.player = null;
  }

  /** @param {string} _name @param {string | null} before @param {string | null} now */
  attributeChangedCallback(_name, before, now) {
    // The event `error` reports a failure.
    if (this.player && now !== null && now !== before) this.player.load(now).catch(() => {});
  }
}

if (!customElements.get("tcgs-player")) customElements.define("tcgs-player", TcgsPlayerElement);
