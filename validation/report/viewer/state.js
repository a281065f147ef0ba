// What is looked at, and its address: everything in location.hash, so that a link shows the same.
import { pairOf, passesOf, run } from "viewer/data.js";

/** @typedef {"side" | "slider" | "flip" | "diff" | "heat" | "flipmap" | "verdict"} Mode */

/**
 * @typedef {Object} State
 * @property {SceneEntry} scene
 * @property {string} pass
 * @property {number} a place of the renderer
 * @property {number} b
 * @property {Mode} mode
 * @property {[number, number] | null} pixel
 * @property {number} zoom pixels of the screen for one of the picture; 0: all of it is in sight
 * @property {[number, number]} centre of the window, in pixels of the picture
 * @property {number} exposure in stops
 * @property {boolean} clip
 * @property {boolean} edges
 * @property {number} split where the slider stands, from 0 to 1
 * @property {boolean} flipped
 * @property {string} find
 * @property {boolean} failed
 * @property {string} onlyPass
 * @property {string} onlyRenderer
 */

/** @type {Mode[]} */
const MODES = ["side", "slider", "flip", "diff", "heat", "flipmap", "verdict"];

/**
 * Where one has to look first: the pair and pass that differ, else the first, and the worst pixel there.
 * @param {SceneEntry} scene
 * @param {string} [pass] if that is wanted
 * @returns {Pick<State, "scene" | "pass" | "a" | "b" | "pixel" | "centre">}
 */
export function worst(scene, pass = "") {
  const names = passesOf(scene);
  const wanted = (/** @type {Pair} */ pair) =>
    names.filter((name) => pair.passes[name] && (!pass || name === pass));
  const bad = (/** @type {Pair} */ pair) => wanted(pair).find((name) => !pair.passes[name].ok);
  const pairs = scene.pairs;
  const pair =
    pairs.find((one) => bad(one)) ??
    pairs.find((one) => one.verdicts.some((verdict) => !verdict.explained)) ??
    pairs.find((one) => wanted(one).length) ??
    pairs[0];
  const name = bad(pair) ?? wanted(pair)[0] ?? names[0];
  const verdict = pair.verdicts.find((one) => !one.explained) ?? null;
  const largest = pair.passes[name] && !pair.passes[name].ok ? pair.passes[name].worst : null;
  // A pixel of which the page knows why says more than the one that is off most.
  const judged = pair.verdicts.some((one) => one.x === largest?.x && one.y === largest?.y);
  const place = judged ? largest : (verdict ?? largest);
  return {
    scene,
    pass: name,
    a: pair.a,
    b: pair.b,
    pixel: place ? [place.x, place.y] : null,
    centre: [scene.size[0] / 2, scene.size[1] / 2],
  };
}

/** @returns {State} */
export function initial() {
  return {
    ...worst(run.scenes[0]),
    mode: "side",
    zoom: 0,
    exposure: 0,
    clip: false,
    edges: false,
    split: 0.5,
    flipped: false,
    find: "",
    failed: false,
    onlyPass: "",
    onlyRenderer: "",
  };
}

/**
 * @param {State} state
 * @returns {string}
 */
export function address(state) {
  const { scene } = state;
  const entries = new URLSearchParams({
    scene: scene.label,
    size: scene.size.join("x"),
    ...(scene.as ? { as: scene.as } : {}),
    pass: state.pass,
    a: scene.renderers[state.a].name,
    b: scene.renderers[state.b].name,
    mode: state.mode,
  });
  if (state.pixel) entries.set("at", state.pixel.join(","));
  if (state.zoom) {
    entries.set("zoom", String(+state.zoom.toFixed(4)));
    entries.set("centre", state.centre.map((value) => +value.toFixed(2)).join(","));
  }
  if (state.exposure) entries.set("exposure", String(state.exposure));
  if (state.clip) entries.set("clip", "1");
  if (state.edges) entries.set("edges", "1");
  if (state.mode === "slider") entries.set("split", String(+state.split.toFixed(3)));
  if (state.mode === "flip" && state.flipped) entries.set("flipped", "1");
  if (state.find) entries.set("find", state.find);
  if (state.failed) entries.set("failed", "1");
  if (state.onlyPass) entries.set("only-pass", state.onlyPass);
  if (state.onlyRenderer) entries.set("only-renderer", state.onlyRenderer);
  return "#/" + entries.toString();
}

/**
 * What an address says; where it says nothing, or what there is not, what one looks at first.
 * @param {string} hash
 * @returns {State}
 */
export function fromAddress(hash) {
  const state = initial();
  if (!hash.startsWith("#/")) return state;
  const entries = new URLSearchParams(hash.slice(2));
  const of = (/** @type {string} */ key) => entries.get(key) ?? "";
  const named = run.scenes.filter((entry) => entry.label === of("scene"));
  const sized = named.filter((entry) => entry.size.join("x") === of("size"));
  const asked = [of("a"), of("b")];
  const has = (/** @type {SceneEntry} */ entry) => asked.every((name) => entry.renderers.some((one) => one.name === name));
  const scene = sized.find((entry) => entry.as === of("as")) ?? sized.find(has) ?? sized[0] ?? named[0];
  if (scene) Object.assign(state, worst(scene));
  if (scene && passesOf(scene).includes(of("pass"))) state.pass = of("pass");
  if (scene) {
    const place = (/** @type {string} */ name) => scene.renderers.findIndex((entry) => entry.name === name);
    if (place(of("a")) >= 0) state.a = place(of("a"));
    if (place(of("b")) >= 0) state.b = place(of("b"));
    state.pixel = null;
  }
  const mode = MODES.find((one) => one === of("mode"));
  if (mode) state.mode = mode;
  const numbers = (/** @type {string} */ key) => of(key).split(",").map(Number);
  const [x, y] = numbers("at");
  const [columns, rows] = state.scene.size;
  if (of("at") && x >= 0 && y >= 0 && x < columns && y < rows) state.pixel = [Math.floor(x), Math.floor(y)];
  const zoom = Number(of("zoom"));
  if (zoom > 0 && zoom <= 256) {
    state.zoom = zoom;
    const [cx, cy] = numbers("centre");
    if (isFinite(cx) && isFinite(cy)) state.centre = [cx, cy];
  }
  const exposure = Number(of("exposure"));
  if (isFinite(exposure)) state.exposure = Math.max(-8, Math.min(16, exposure));
  state.clip = of("clip") === "1";
  state.edges = of("edges") === "1";
  state.flipped = of("flipped") === "1";
  const split = Number(of("split"));
  if (of("split") && split >= 0 && split <= 1) state.split = split;
  state.find = of("find");
  state.failed = of("failed") === "1";
  state.onlyPass = of("only-pass");
  state.onlyRenderer = of("only-renderer");
  return state;
}

/**
 * The comparison that is looked at, if there was one.
 * @param {State} state
 */
export function comparison(state) {
  const found = pairOf(state.scene, state.a, state.b);
  return found ? { ...found, comparison: found.pair.passes[state.pass] } : null;
}
