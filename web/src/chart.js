// A small curve: a line in a box, with its name, its last value and its range in words.

const [WIDTH, HEIGHT, MARGIN] = [240, 48, 3];

/**
 * Points of a line in a box of `WIDTH` x `HEIGHT`, `x,y x,y …`; y points down.
 * @param {[number, number][]} points finite; x ascends
 * @param {{log?: boolean, range?: [number, number]}} options `log`: logarithmic, if all values are above 0; `range`:
 *   range of values, otherwise that of the points
 */
export function line(points, { log = false, range } = {}) {
  const [first, last] = [points[0][0], points.at(-1)[0]];
  const scale = log && points.every(([, y]) => y > 0) ? Math.log : (y) => y;
  const values = points.map(([, y]) => scale(y));
  const [least, most] = range ? range.map(scale) : [Math.min(...values), Math.max(...values)];
  const across = (x) => (last > first ? ((x - first) / (last - first)) * WIDTH : WIDTH / 2);
  const down = (value) => (most > least ? MARGIN + ((most - value) / (most - least)) * (HEIGHT - 2 * MARGIN) : HEIGHT / 2);
  const places = points.map(([x], i) => [across(x), down(values[i])]);
  // One point is a short line.
  if (places.length === 1) places.push([places[0][0] + 4, places[0][1]]);
  return places.map((place) => place.map((x) => x.toFixed(1)).join(",")).join(" ");
}

/** A number with three significant digits. */
export const digits = (value) => String(Number(value.toPrecision(3)));

const svg = (name, attributes) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
};

/**
 * A curve that can be redrawn: `{figure, show(points)}`. Without points it is hidden.
 * @param {string} name such as `Loss`
 * @param {string} over what x counts, such as `iterations`
 * @param {{unit?: string, log?: boolean, range?: [number, number], factor?: number}} options `factor`: multiplies the
 *   values in words
 */
export function chart(name, over, { unit = "", factor = 1, ...how } = {}) {
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  const title = document.createElement("span");
  const value = document.createElement("b");
  title.textContent = name;
  caption.append(title, value);
  const curve = svg("polyline", { fill: "none", "vector-effect": "non-scaling-stroke" });
  const box = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img" });
  box.append(curve);
  figure.append(caption, box);
  figure.hidden = true;
  const show = (points) => {
    const known = points.filter(([, y]) => Number.isFinite(y));
    figure.hidden = known.length === 0;
    if (figure.hidden) return;
    const told = (y) => `${digits(factor * y)}${unit}`;
    const [from, to] = [told(known[0][1]), told(known.at(-1)[1])];
    value.textContent = to;
    curve.setAttribute("points", line(known, how));
    box.setAttribute("aria-label", `${name} over ${known.length} points of ${over}, from ${from} to ${to}`);
  };
  return { figure, show };
}
