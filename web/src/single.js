// Starts a page that is one file: its modules, an engine and the scene are texts in it.

/** Bytes of a text of the page, base64 of gzip. */
async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const bytes = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(bytes).arrayBuffer();
}

const files = new Map();
for (const part of document.querySelectorAll("script[data-file]")) {
  files.set(part.dataset.file, await unpack(part.textContent));
}
const scene = document.querySelector("script[data-scene]");
globalThis.tcgsScene = new File([await unpack(scene.textContent)], scene.dataset.scene);

/** Content as an address of its own. In Chromium a worker of a page from a disk may read no `blob:` of the page. */
function dataAddress(content, type) {
  let characters = "";
  const bytes = typeof content === "string" ? new TextEncoder().encode(content) : new Uint8Array(content);
  for (let at = 0; at < bytes.length; at += 1 << 15) {
    characters += String.fromCharCode(...bytes.subarray(at, at + (1 << 15)));
  }
  return `data:${type};base64,${btoa(characters)}`;
}

const addresses = new Map();
/** Address of a file, in which the files that it names have addresses of their own. */
function address(name) {
  if (!addresses.has(name)) {
    const isModule = name.endsWith(".js");
    const type = isModule ? "text/javascript" : "application/wasm";
    // The names of other modules, and of the engine beside its module.
    const named = /(["'])(?:\.\/)?([\w./-]+\.(?:js|wasm))\1(?=\)?[;,]| *[,)])/g;
    const folder = name.slice(0, name.lastIndexOf("/") + 1);
    const linked = (whole, quote, other) => {
      const found = [folder + other, other].find((path) => path !== name && files.has(path));
      return found ? quote + address(found) + quote : whole;
    };
    const content = isModule ? new TextDecoder().decode(files.get(name)).replace(named, linked) : files.get(name);
    const isForWorker = folder !== "" || name === "worker.js";
    addresses.set(name, isForWorker ? dataAddress(content, type) : URL.createObjectURL(new Blob([content], { type })));
  }
  return addresses.get(name);
}

await import(address("main.js"));
