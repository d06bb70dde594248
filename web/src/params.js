// Parameters of the page's address: ?src=…&view=2&speed=0.5 and so on (docs/PLAYER.md has the table).

const flag = (text, otherwise) => (text === null ? otherwise : !["0", "false", "no", "off"].includes(text));

const number = (text, least, most, otherwise) => {
  const value = text === null || text.trim() === "" ? NaN : Number(text);
  return value >= least && value <= most ? value : otherwise;
};

/** @param {string} query of the address, with its question mark */
export function readParams(query) {
  const given = new URLSearchParams(query);
  const theme = given.get("theme");
  return {
    src: given.get("src"),
    cameras: given.get("cameras"),
    autoplay: flag(given.get("autoplay"), true),
    loop: flag(given.get("loop"), true),
    controls: flag(given.get("controls"), true),
    stats: flag(given.get("stats"), false),
    trust: flag(given.get("trust"), true),
    speed: number(given.get("speed"), 0.05, 16, 1),
    timestep: number(given.get("timestep"), 0, 1e9, 0),
    /** Camera of the file to start from; null: the start view. */
    view: number(given.get("view"), 0, 1e6, null),
    theme: ["light", "dark"].includes(theme) ? theme : null,
    /** "fixed": every pixel is drawn, however long that takes. */
    quality: given.get("quality") === "fixed" ? "fixed" : "auto",
    /** The only renderer to try; null: the better one that works. */
    renderer: ["webgpu", "webgl2"].includes(given.get("renderer")) ? given.get("renderer") : null,
    /** Device pixels per CSS pixel; null: as the screen has. */
    dpr: number(given.get("dpr"), 0.1, 8, null),
  };
}
