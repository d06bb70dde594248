// The stage: a film of a scene, or the player in its place once somebody asks for it. And the tabs.

const element = (id) => document.getElementById(id);
const [stage, film, file] = ["stage", "film", "file"].map(element);
const choices = [...document.querySelectorAll("[data-scene]")];
/** Whether nothing should move by itself, or be loaded for that. */
const still = matchMedia("(prefers-reduced-motion: reduce)").matches || navigator.connection?.saveData;
/** The player's element once it is there; null: the film shows. */
let player = null;
/** The scene that is chosen; null: a visitor's file. */
let scene = "toss";

/** Whether this browser draws scenes, by WebGPU or by WebGL2. Asking takes no download. */
async function draws() {
  const adapter = await navigator.gpu?.requestAdapter().catch(() => null);
  if (adapter) return true;
  const context = document.createElement("canvas").getContext("webgl2");
  // Browsers keep few contexts.
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}

/** Says what is on the stage. @param {string | null} name of the scene */
function tell(name) {
  scene = name;
  for (const choice of choices) choice.setAttribute("aria-pressed", String(choice.dataset.scene === name));
  for (const text of document.querySelectorAll("[data-of]")) text.hidden = text.dataset.of !== (name ?? "own");
  element("take").hidden = name === null;
  if (name === null) return;
  const source = encodeURIComponent(new URL(`scenes/${name}.tcgs`, location.href).href);
  const player = new URL("player/index.html", location.href).href;
  const address = `${player}?src=${source}&controls=0`;
  element("embed").textContent = `<iframe src="${address}" allow="fullscreen; xr-spatial-tracking"></iframe>`;
}

/** Puts the player on the stage, with a scene's address or a file. @param {string | File} source */
async function play(source) {
  if (!(await draws())) return showFilm(scene);
  try {
    await import("./player/element.js");
  } catch {
    element("failed").hidden = false;
    return;
  }
  element("failed").hidden = true;
  if (!player) {
    player = document.createElement("tcgs-player");
    player.title = "3D scene";
    player.addEventListener("error", ({ detail }) => {
      if (detail.code === "no-webgpu" || detail.code === "insecure") showFilm(scene);
    });
    film.pause();
    film.hidden = element("over").hidden = true;
    stage.prepend(player);
  }
  element("keys").hidden = false;
  player.focus({ preventScroll: true });
  stage.scrollIntoView({ block: "nearest" });
  // A failure is told by the player itself, and by the event above.
  player.player.load(source).catch(() => {});
}

/** Puts a scene's film on the stage, because the player cannot draw here. @param {string | null} name */
function showFilm(name) {
  player?.remove();
  player = null;
  film.hidden = element("over").hidden = false;
  element("keys").hidden = element("turn").hidden = true;
  element("note").hidden = false;
  element("note").querySelector("span").hidden = name === null;
  if (name === null) return;
  const poster = `pictures/${name}.webp`;
  if (film.getAttribute("poster") === poster) return run(!still);
  film.poster = poster;
  film.setAttribute("aria-label", document.querySelector(`[data-of=${name}]`).textContent.split(":")[0]);
  for (const source of film.querySelectorAll("source")) source.src = `pictures/${name}.${source.src.split(".").pop()}`;
  film.load();
  run(!still);
}

/** Lets the film run, or stops it. A browser may refuse; then the poster stays. */
function run(on) {
  if (on) film.play().catch(() => {});
  else film.pause();
}

function open(chosen) {
  if (!chosen) return;
  element("name").textContent = chosen.name;
  tell(null);
  play(chosen);
}

for (const choice of choices) {
  choice.addEventListener("click", () => {
    tell(choice.dataset.scene);
    play(`scenes/${scene}.tcgs`);
  });
}
element("turn").addEventListener("click", () => play(`scenes/${scene}.tcgs`));
element("own").addEventListener("click", () => file.click());
file.addEventListener("change", () => {
  open(file.files[0]);
  file.value = "";
});
window.addEventListener("dragover", (event) => {
  event.preventDefault();
  document.body.classList.add("dropping");
});
window.addEventListener("dragleave", (event) => {
  if (event.relatedTarget === null) document.body.classList.remove("dropping");
});
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  open(event.dataTransfer.files[0]);
});

element("pause").addEventListener("click", () => run(film.paused));
for (const type of ["play", "pause"]) {
  film.addEventListener(type, () => {
    element("pause").classList.toggle("stopped", film.paused);
    element("pause").setAttribute("aria-label", film.paused ? "Play the film" : "Stop the film");
  });
}
element("turn").hidden = element("pause").hidden = false;
element("pause").classList.add("stopped");
element("pause").setAttribute("aria-label", "Play the film");
if (!still) run(true);
tell(scene);
draws().then((can) => can || showFilm(scene));

// Tabs: without this script all panels show, one below the other.
const tabs = [...document.querySelectorAll("[role=tab]")];

function select(tab) {
  for (const other of tabs) {
    const chosen = other === tab;
    other.setAttribute("aria-selected", String(chosen));
    other.tabIndex = chosen ? 0 : -1;
    element(other.getAttribute("aria-controls")).hidden = !chosen;
  }
}

tabs.forEach((tab, i) => {
  const panel = element(tab.getAttribute("aria-controls"));
  panel.setAttribute("role", "tabpanel");
  panel.setAttribute("aria-labelledby", tab.id);
  tab.addEventListener("click", () => select(tab));
  tab.addEventListener("keydown", ({ key }) => {
    const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: -1 }[key];
    if (to === undefined) return;
    const next = tabs.at(to % tabs.length);
    select(next);
    next.focus();
  });
});
select(tabs[0]);
tabs[0].parentElement.hidden = false;
