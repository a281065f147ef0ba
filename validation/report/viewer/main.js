// The viewer: reads the address, draws what it says, and writes it when keys, buttons or the pointer change something.
import { brightened, decades, differences, inferno, logarithmic, magma, measured, picture, range, signed } from "viewer/colors.js";
import { flags as flagsOf, margins, number, passesOf, plane, rowOf, run, signedErrors, trim, variant } from "viewer/data.js";
import { brief, causes, escaped, inspect, spoken } from "viewer/inspector.js";
import { fillList, filtered, markScene, matrix, pictureAddress, thumbnail } from "viewer/list.js";
import { MARKS, markSvg, who } from "viewer/marks.js";
import { outline, styles } from "viewer/outlines.js";
import { Stage } from "viewer/stage.js";
import { address, comparison, fromAddress, worst } from "viewer/state.js";

/** @typedef {import("viewer/state.js").State} State */
/** @typedef {import("viewer/state.js").Mode} Mode */
/** @typedef {import("viewer/stage.js").Pane} Pane */
/** @typedef {import("viewer/stage.js").Outline} Outline */

/**
 * An element of the page.
 * @template {HTMLElement} T
 * @param {string} id
 * @returns {T}
 */
function element(id) {
  return /** @type {T} */ (document.getElementById(id));
}

const viewer = element("viewer");
const report = element("report");
const [list, inspector, stageElement] = ["v-scenes", "v-values", "v-stage"].map(element);
const passSelect = /** @type {HTMLSelectElement} */ (element("v-pass"));
const [aSelect, bSelect] = ["v-a", "v-b"].map((id) => /** @type {HTMLSelectElement} */ (element(id)));
const filterPass = /** @type {HTMLSelectElement} */ (element("v-filter-pass"));
const filterRenderer = /** @type {HTMLSelectElement} */ (element("v-filter-renderer"));
const [search, failedBox, exposure, clipBox, edgesBox] = ["v-search", "v-failed", "v-exposure", "v-clip", "v-edges"].map(
  (id) => /** @type {HTMLInputElement} */ (element(id)),
);
const [summary, help] = ["v-summary", "v-help"].map((id) => /** @type {HTMLDialogElement} */ (element(id)));

const KINDS = styles(run.kinds);
/** Exponents of the zoom buttons. */
const ZOOM_STEP = 2;

/** @type {State} */
let state = fromAddress("");
/**
 * The pixel under the pointer, while nothing is chosen.
 * @type {[number, number] | null}
 */
let hovered = null;
/** Counts what was asked for, so that what comes late is dropped. */
let turn = 0;
/** What is on the screen, for what need not be made again. */
let drawn = "";
/** Which way the list was walked last. */
let direction = 1;

/** @type {{ planes: Map<string, Plane | null>, margins: Float32Array | null, flags: Uint8Array | null, scene: SceneEntry | null }} */
const have = { planes: new Map(), margins: null, flags: null, scene: null };

/** @type {Stage} */
const stage = new Stage(stageElement, {
  hover: (pixel) => {
    hovered = pixel;
    if (!state.pixel) inspectSoon();
  },
  pick: (pixel) => {
    const same = state.pixel && state.pixel[0] === pixel[0] && state.pixel[1] === pixel[1];
    change({ pixel: same ? null : pixel });
  },
  move: (zoom, centre) => change({ zoom, centre: clamped(centre) }),
  split: (split) => change({ split }),
  resize: () => (element("v-zoom").textContent = `${brief(stage.scale())}×`),
});

/**
 * @param {[number, number]} centre
 * @returns {[number, number]}
 */
function clamped(centre) {
  const [columns, rows] = state.scene.size;
  return [Math.max(0, Math.min(columns, centre[0])), Math.max(0, Math.min(rows, centre[1]))];
}

/**
 * Something else is to be looked at.
 * @param {Partial<State>} changes
 */
function change(changes) {
  state = { ...state, ...changes };
  writeAddress();
  void draw();
}

let writing = 0;
/** The scene of the address. */
let addressed = "";
/** The address as it was written or heeded last. */
let known = location.hash;
/** Browsers refuse to write an address more than 200 times in 30 seconds. Back leads to the scene before. */
function writeAddress() {
  if (writing) return;
  writing = window.setTimeout(() => {
    writing = 0;
    // Another address, that of a link or of a hand, is heeded first: see route.
    if (viewer.hidden || location.hash !== known) return;
    const further = addressed !== "" && addressed !== state.scene.key;
    addressed = state.scene.key;
    if (further) history.pushState(null, "", address(state));
    else history.replaceState(null, "", address(state));
    known = location.hash;
  }, 160);
}

/** @param {SceneEntry} scene */
function choose(scene) {
  if (scene === state.scene) return;
  change({ ...landing(scene), zoom: 0, exposure: 0, flipped: false });
}

/**
 * What to show of another scene: the same pass and renderers where nothing is wrong with it, else what is wrong.
 * @param {SceneEntry} scene
 */
function landing(scene) {
  const names = [state.a, state.b].map((place) => state.scene.renderers[place]?.name);
  const found = worst(scene, state.onlyPass);
  const bad = scene.pairs.some((pair) => !pair.ok);
  const places = names.map((name) => scene.renderers.findIndex((renderer) => renderer.name === name));
  if (bad || places.includes(-1)) return found;
  const pass = passesOf(scene).includes(state.pass) ? state.pass : found.pass;
  return { ...found, a: places[0], b: places[1], pass, pixel: null };
}

/**
 * A canvas with these pixels.
 * @param {ImageData} pixels
 */
function canvas(pixels) {
  const made = Object.assign(document.createElement("canvas"), { width: pixels.width, height: pixels.height });
  made.getContext("2d")?.putImageData(pixels, 0, 0);
  return made;
}

/** @type {Map<string, HTMLImageElement>} */
const loaded = new Map();
/**
 * A picture of the page.
 * @param {string | undefined} key
 */
async function pictureOf(key) {
  if (!key) return null;
  const image = loaded.get(key) ?? new Image();
  if (!loaded.has(key)) image.src = pictureAddress(key);
  loaded.set(key, image);
  await image.decode().catch(() => undefined);
  // What no picture is, a canvas refuses to draw.
  return image.naturalWidth ? image : null;
}

/** What is drawn of the pictures of one comparison; made again only when one of these changes. */
/** @type {{ key: string, flags: Uint8Array | null, panes: Pane[], how: string, bar: string }} */
let made = { key: "", flags: null, panes: [], how: "", bar: "" };

async function draw() {
  const mine = ++turn;
  controls();
  const { scene, pass, a, b, mode } = state;
  if (have.scene !== scene) {
    if (have.scene) trim(have.scene, wantedOf(landing(have.scene)));
    have.planes.clear();
    have.margins = null;
    have.scene = scene;
    await placeholder(mine);
  }
  const now = comparison(state);
  const key = [scene.key, pass, a, b, mode, state.exposure, state.clip, state.flipped && mode === "flip"].join(" ");
  if (made.key !== key) {
    const flags = await flagsOf(scene, now?.comparison);
    if (mine !== turn) return;
    have.flags = flags;
    const fresh = mode === "flipmap" ? await fromFlip() : scene.floats ? await fromFloats(mine) : await fromPictures();
    if (mine !== turn || !fresh) return;
    made = { key, flags, ...fresh };
    element("v-how").textContent = made.how;
    element("v-bar").innerHTML = made.bar;
  }
  // Another comparison may have been begun and given up.
  have.flags = made.flags;
  stageElement.dataset.mode = mode;
  stage.show({
    about: `${pass} of ${scene.label}${variant(scene)}`,
    size: scene.size,
    panes: made.panes,
    outlines: outlines(),
    verdicts: mode === "verdict" ? (now?.pair.verdicts ?? []) : [],
    pixel: state.pixel,
    zoom: state.zoom,
    centre: state.centre,
    split: state.split,
  });
  const scale = stage.scale();
  element("v-zoom").textContent = `${scale < 1 ? Number(scale.toPrecision(2)) : brief(scale)}×`;
  inspectSoon();
  if (drawn !== `${scene.key} ${a} ${b}`) {
    drawn = `${scene.key} ${a} ${b}`;
    void fetchOthers(mine, scene);
  }
  const shown = address(state);
  requestAnimationFrame(() => {
    stageElement.dataset.ready = shown; // behind the drawing, which was asked for before
  });
}

/**
 * The picture of another scene at once, until its values are there.
 * @param {number} mine
 */
async function placeholder(mine) {
  const image = await pictureOf(thumbnail(state.scene));
  if (mine !== turn || !image) return;
  const title = "reading …";
  const panes = (state.mode === "side" ? [0, 1] : [0]).map(() => ({ title, image }));
  const { pixel, zoom, centre, split } = state;
  const about = `${state.pass} of ${state.scene.label}${variant(state.scene)}`;
  stage.show({ about, size: state.scene.size, panes, outlines: [], verdicts: [], pixel, zoom, centre, split });
}

/**
 * The values that neighbours in the list would show, read before they are asked for.
 * @param {SceneEntry} scene
 * @param {number} distance
 */
async function readAhead(scene, distance) {
  const scenes = filtered(state).map((entry) => entry.scene);
  const at = scenes.indexOf(scene);
  for (const next of [scenes[at + distance * direction], scenes[at - distance * direction]]) {
    if (!next) continue;
    const shown = landing(next);
    const wanted = wantedOf(shown);
    await flagsOf(next, comparison({ ...state, ...shown })?.comparison);
    for (const [place, name] of wanted) {
      if (state.scene !== scene) return;
      await plane(next, place, name);
    }
    if (state.scene === scene) trim(next, wanted);
  }
}

/**
 * The planes that a picture of a scene is made of.
 * @param {Pick<State, "pass" | "a" | "b">} shown
 * @returns {[number, string][]}
 */
function wantedOf({ pass, a, b }) {
  return [[a, pass], [b, pass], [a, "id"], [b, "id"]];
}

/**
 * @param {number} place
 * @param {string} name
 */
async function need(place, name) {
  const { scene } = state;
  const found = await plane(scene, place, name);
  if (have.scene === scene) have.planes.set(`${place} ${name}`, found);
  return found;
}

/** @type {{ flags: Uint8Array | null, found: Outline[] }} */
let outlined = { flags: null, found: [] };
/** Outlines of the kinds that there are; found once, as long as the map is the same. */
function outlines() {
  if (!state.edges || !have.flags) return [];
  if (outlined.flags !== have.flags) outlined = { flags: have.flags, found: trace(have.flags, state.scene.size) };
  return outlined.found;
}

/**
 * @param {Uint8Array} all
 * @param {[number, number]} size
 */
function trace(all, size) {
  const known = Object.values(run.kinds).reduce((sum, bit) => sum | bit, 0);
  return KINDS.flatMap((kind) => {
    const path = outline(all, kind.bit, size, kind.bit === 4 ? known : 0);
    return path ? [{ kind, path }] : [];
  });
}

/** @type {{ planes: Plane[], limits: ReturnType<typeof range> | null }} */
let ranged = { planes: [], limits: null };
/**
 * The range of two planes, once.
 * @param {Plane[]} planes
 * @param {(Plane | null)[]} ids
 */
function limitsOf(planes, ids) {
  const same = ranged.planes.length === planes.length && planes.every((one, i) => one === ranged.planes[i]);
  const limits = (same && ranged.limits) || range(planes, ids);
  ranged = { planes, limits };
  return limits;
}

/** @param {number} mine */
async function fromFloats(mine) {
  const { scene, pass, a, b, mode } = state;
  const row = rowOf(pass);
  const now = comparison(state);
  const [first, second, idsA, idsB, told] = await Promise.all([
    need(a, pass), need(b, pass), need(a, "id"), need(b, "id"), pass === "beauty" ? signedErrors(scene, now?.pair) : null,
  ]);
  if (mine !== turn) return null;
  const names = [a, b].map((place) => scene.renderers[place].name);
  const title = (/** @type {number} */ side) => `${"AB"[side]}  ${names[side]}`;
  const planes = /** @type {[Plane | null, Plane | null]} */ ([first, second]);
  const lacking = planes.map((one, side) => (one ? "" : `${names[side]} has no ${pass}`)).filter(Boolean).join("; ");
  const there = /** @type {Plane[]} */ (planes.filter(Boolean));
  if (!there.length) return { panes: [], how: lacking, bar: "" };
  const limits = limitsOf(there, planes.flatMap((one, side) => (one ? [[idsA, idsB][side]] : [])));
  const auto = brightened(row, limits);
  const paint = (/** @type {number} */ side) => {
    const one = planes[side];
    if (!one) return canvas(new ImageData(scene.size[0], scene.size[1]));
    return canvas(picture(row, one, [idsA, idsB][side], limits, scene.size, state.exposure + auto, state.clip));
  };
  const levels = pass === "beauty" ? inLevels(scene, a, b) : "";
  const shown = how(row, limits, auto) + levels + (lacking ? `; ${lacking}` : "");
  const whole = { how: shown, bar: "" };
  if (mode === "side") return { ...whole, panes: [0, 1].map((side) => ({ title: title(side), image: paint(side) })) };
  if (mode === "slider") {
    return { ...whole, panes: [{ title: `${title(0)}  |  ${title(1)}`, image: paint(0), right: paint(1) }] };
  }
  if (mode === "flip") {
    const side = state.flipped ? 1 : 0;
    return { ...whole, how: `${shown}; f shows the other`, panes: [{ title: title(side), image: paint(side) }] };
  }
  if (mode === "verdict") return { ...whole, ...verdictPane(paint(0)) };
  if (!first || !second) return { ...whole, panes: [{ title: lacking, image: canvas(new ImageData(...scene.size)) }] };
  const bits = have.flags;
  const hitsOnly = row.quantity === "length" || row.quantity === "position" || row.quantity === "normal";
  const bothHit = (/** @type {number} */ i) => !hitsOnly || !((idsA?.values[i] ?? 0) < 0 || (idsB?.values[i] ?? 0) < 0);
  const compared = bits ? (/** @type {number} */ i) => (bits[i] & 1) !== 0 : bothHit;
  const { errors, signs } = told ? measured(told, now?.turned ?? false, compared) : differences(row, first, second, compared);
  const scale = decades(errors, bits ? (i) => (bits[i] & 4) !== 0 : () => false);
  const both = mode === "diff";
  const image = canvas(logarithmic(both ? signs : errors, scale, scene.size, both));
  const rest = [a, b].map((place) => scene.renderers[place].passes[pass]);
  const lost = rest.every((one) => one?.wide) && !rest.some((one) => one?.rest);
  const rounded = [first, second].every((one) => one.exact)
    ? ""
    : `; float64 is rounded to float32 to keep the page small${lost ? ": differences below 6e-8 of a value do not show" : ""}`;
  const from = told ? ", from the colours that a level stands for" : "";
  const what = both
    ? `A − B of the channel that differs most${from}; orange and +: A is larger, blue and −: B is larger`
    : `largest difference of a channel${row.quantity === "normal" ? "s' vector" : ""}${from}, brighter is larger`;
  const bytes = levels && !told ? `${levels}; these two were not compared: a level counts as the colour that it is over their number` : levels;
  const none = scale ? "" : "; there is no difference";
  const few = scale ? ` or below 1e${scale[0]}` : "";
  return {
    panes: [{ title: both ? `${names[0]} − ${names[1]}` : `error of ${names[0]} against ${names[1]}`, image, signs: both ? signs : undefined }],
    how: `${what}; black: ${told ? "the right level" : "none"}${few}; see-through: not compared${none}${bytes}${rounded}`,
    bar: scale ? colorBar(scale, both, errors.some((error) => error > 10 ** scale[1])) : "",
  };
}

/** @param {CanvasImageSource} image */
function verdictPane(image) {
  const now = comparison(state);
  const found = now?.pair.verdicts ?? [];
  const names = (now ? [now.pair.a, now.pair.b] : [state.a, state.b]).map((place) => state.scene.renderers[place].name);
  const marks = /** @type {Mark[]} */ (["square", "circle", "both", "dot"]);
  const legend = marks.flatMap((mark) => {
    const count = found.filter((verdict) => who(verdict) === mark).length;
    return count ? [`<span>${markSvg(mark)} ${escaped(MARKS[mark].says(names[0], names[1]))}: ${count}</span>`] : [];
  });
  const crossed = found.filter((verdict) => !verdict.explained).length;
  if (crossed) legend.push(`<span>${markSvg("cross")} ${MARKS.cross.says("", "")}: ${crossed}</span>`);
  const differ = now?.pair.differ ?? 0;
  const told = !now
    ? "these two were not compared in this run"
    : found.length
      ? `${found.length} of ${differ} pixels that differ, in any pass, were judged`
      : differ
        ? `${differ} pixels differ, none was judged`
        : "no pixel differs by more than its tolerance";
  return { panes: [{ title: `verdicts on ${names.join(" and ")}`, image, grey: true }], how: told, bar: `<p class="key">${legend.join("")}</p>` };
}

/** Without float data there are the pictures of comparisons that were made. */
async function fromPictures() {
  const { mode, scene } = state;
  const now = comparison(state);
  const one = now?.comparison;
  const names = [state.a, state.b].map((place) => scene.renderers[place].name);
  const keys = now?.turned ? [one?.picture_b, one?.picture_a] : [one?.picture_a, one?.picture_b];
  const [first, second, heat] = await Promise.all([pictureOf(keys[0]), pictureOf(keys[1]), pictureOf(one?.picture_heat)]);
  const nothing = canvas(new ImageData(...scene.size));
  const how = `${one?.how ?? "the page has no picture of this"}; without float data exposure and differences are left out`;
  const none = { how, bar: "" };
  const title = (/** @type {number} */ side) => `${"AB"[side]}  ${names[side]}`;
  const [a, b] = [first ?? nothing, second ?? nothing];
  if (mode === "side") return { ...none, panes: [{ title: title(0), image: a }, { title: title(1), image: b }] };
  if (mode === "slider") return { ...none, panes: [{ title: `${title(0)}  |  ${title(1)}`, image: a, right: b }] };
  if (mode === "flip") return { ...none, panes: [{ title: title(state.flipped ? 1 : 0), image: state.flipped ? b : a }] };
  if (mode === "verdict") return { ...none, ...verdictPane(a) };
  if (mode === "diff") return { ...none, panes: [{ title: "no float data, no signed difference", image: nothing }] };
  const ticks = one?.ticks ?? [];
  const bar = ticks.length ? barOf(ticks, (share) => inferno(share)) : "";
  const told = heat ? "largest difference of a channel; black: none" : "no difference, or the page has no picture of it";
  return { panes: [{ title: `error of ${names.join(" against ")}`, image: heat ?? nothing }], how: told, bar };
}

/** Why there is no map of FLIP; empty where there is one. */
function withoutFlip() {
  const one = comparison(state)?.comparison;
  if (!one) return "these two were not compared in this pass";
  if (one.flip) return "";
  return state.pass === "beauty" ? "no map of FLIP: whitted validate --flip measures it" : "FLIP is of beauty alone";
}

/** What one sees who flips between the two images. */
async function fromFlip() {
  const { scene } = state;
  const nothing = canvas(new ImageData(...scene.size));
  const reason = withoutFlip();
  if (reason) return { panes: [{ title: reason, image: nothing }], how: reason, bar: "" };
  const one = comparison(state)?.comparison;
  const image = await pictureOf(one?.picture_flip);
  const names = [state.a, state.b].map((place) => scene.renderers[place].name);
  const told = `up to ${brief(number(one?.flip?.max ?? null))}, mean ${brief(number(one?.flip?.mean ?? null))}`;
  return {
    panes: [{ title: `FLIP of ${names.join(" and ")}, ${told}`, image: image ?? black(scene.size) }],
    how: `what an eye sees that flips between the two 8-bit images, at 67 pixels a degree; black: nothing${image ? "" : ", anywhere"}`,
    bar: barOf([0, 0.25, 0.5, 0.75, 1].map((share) => [share, String(share)]), magma),
  };
}

/** @param {[number, number]} size */
function black(size) {
  const pixels = new ImageData(...size);
  for (let i = 3; i < pixels.data.length; i += 4) pixels.data[i] = 255;
  return canvas(pixels);
}

/**
 * Which of two are levels, and by which rule.
 * @param {SceneEntry} scene
 * @param {number} a
 * @param {number} b
 */
function inLevels(scene, a, b) {
  const sides = [a, b].map((place, side) => {
    const of = scene.renderers[place].encoding;
    return of ? `; ${"AB"[side]} is ${of.steps === 255 ? "bytes" : `levels up to ${of.steps}`}: ${of.says}` : "";
  });
  return sides.join("");
}

/**
 * How values became colours.
 * @param {PassRow} row
 * @param {ReturnType<typeof range>} limits
 * @param {number} auto
 */
function how(row, limits, auto) {
  const [from, to] = [limits.from.map(brief), limits.to.map(brief)];
  if (row.quantity === "id") return "a colour for each sphere; nothing hit: see-through";
  if (row.quantity === "visibility") return "white: the light is visible, black: hidden or nothing hit";
  if (row.quantity === "normal") return "red, green, blue = 0.5 + 0.5 (x, y, z)";
  if (row.quantity === "length") return `bright: ${from[0]}, dark: ${to[0]} world units; nothing hit: see-through`;
  if (row.quantity === "position") return [..."xyz"].map((axis, c) => `${["red", "green", "blue"][c]}: ${axis} from ${from[c]} to ${to[c]}`).join(", ");
  const stops = state.exposure + auto;
  const gain = stops ? `, shown times ${brief(2 ** stops)}` : "";
  const clipped = state.clip ? "; striped: beyond what a screen shows" : "";
  return `linear values from ${brief(Math.min(...limits.from))} to ${brief(Math.max(...limits.to))}${gain}${clipped}`;
}

/**
 * @param {[number, string][]} ticks
 * @param {(share: number) => number[]} color
 */
function barOf(ticks, color) {
  const stops = Array.from({ length: 33 }, (_, i) => `rgb(${color(i / 32).map(Math.round).join(" ")})`);
  const marks = ticks.map(([share, text]) => `<span style="left:${(100 * share).toFixed(2)}%">${text}</span>`);
  return `<div class="scale"><div class="gradient" style="background:linear-gradient(to right,${stops.join(",")})"></div><div class="ticks">${marks.join("")}</div></div>`;
}

/**
 * @param {[number, number]} scale
 * @param {boolean} both
 * @param {boolean} more whether there are larger ones
 */
function colorBar(scale, both, more) {
  const [low, high] = scale;
  const steps = Array.from({ length: high - low + 1 }, (_, i) => low + i);
  const share = (/** @type {number} */ exponent) => (exponent - low) / (high - low);
  const named = (/** @type {number} */ exponent) => `${more && exponent === high ? "≥ " : ""}1e${exponent}`;
  if (!both) return barOf(steps.map((exponent) => [share(exponent), named(exponent)]), inferno);
  const few = steps.length < 4 ? steps : steps.filter((exponent) => (high - exponent) % 2 === 0);
  /** @type {[number, string][]} */
  const ticks = [
    ...few.map((exponent) => /** @type {[number, string]} */ ([0.5 - share(exponent) / 2, `${named(exponent).replace("≥ ", "≤ ").replace("1e", "−1e")}`])),
    ...few.map((exponent) => /** @type {[number, string]} */ ([0.5 + share(exponent) / 2, `${named(exponent).replace("1e", "+1e")}`])),
  ];
  return barOf(ticks.filter(([at]) => Math.abs(at - 0.5) > 0.03), (at) => signed(2 * at - 1 || 1e-9));
}

/**
 * Everything else of the scene, so that the inspector has it when it is asked.
 * @param {number} mine
 * @param {SceneEntry} scene
 */
async function fetchOthers(mine, scene) {
  await readAhead(scene, 1);
  for (const place of scene.renderers.keys()) if (state.scene === scene) await need(place, state.pass);
  if (state.scene === scene) inspectSoon();
  // Whoever runs through the scenes is not kept waiting by what they pass.
  await new Promise((resume) => setTimeout(resume, 250));
  if (state.scene !== scene) return;
  const found = await margins(scene);
  if (state.scene !== scene) return;
  have.margins = found;
  const rest = [state.a, state.b, ...scene.renderers.keys()];
  for (const name of [state.pass, ...passesOf(scene)]) {
    for (const place of new Set(rest)) {
      if (state.scene !== scene) return;
      if (have.planes.has(`${place} ${name}`)) continue;
      await need(place, name);
      await new Promise((resume) => setTimeout(resume));
    }
  }
  if (state.scene === scene && mine) inspectSoon();
  inspector.dataset.complete = scene.key;
  await readAhead(scene, 2);
  inspector.dataset.ahead = scene.key;
}

let speaking = 0;
/** Says a pixel that is kept once it is still, for those who hear the page; what is under the pointer would never end. */
function saySoon() {
  clearTimeout(speaking);
  speaking = window.setTimeout(() => {
    const live = element("v-live");
    const place = (/** @type {number} */ renderer) => have.planes.get(`${renderer} ${state.pass}`);
    const text = state.pixel ? spoken(state, state.pixel, place) : "";
    if (live.textContent !== text) live.textContent = text;
  }, 300);
}

let inspecting = 0;
function inspectSoon() {
  saySoon();
  if (inspecting) return;
  inspecting = requestAnimationFrame(() => {
    inspecting = 0;
    const pixel = state.pixel ?? hovered;
    const where = element("v-where");
    if (!pixel) {
      where.innerHTML = "<b>No pixel</b> <span>Point at the picture; a click keeps the pixel.</span>";
      inspector.innerHTML = overview();
      delete inspector.dataset.at;
      return;
    }
    where.innerHTML = `<b>x ${pixel[0]}, y ${pixel[1]}</b> <span>${state.pixel ? "kept; Esc lets go" : "a click keeps it"}</span>`;
    const flag = have.flags?.[pixel[1] * state.scene.size[0] + pixel[0]] ?? 0;
    inspector.innerHTML = inspect({
      state,
      pixel,
      passes: passesOf(state.scene),
      plane: (place, name) => {
        if (!state.scene.renderers[place].passes[name]) return null;
        return have.planes.get(`${place} ${name}`);
      },
      margins: have.margins,
      flag,
    });
    inspector.dataset.at = pixel.join(",");
    document.getElementById("v-copy")?.addEventListener("click", (event) => copy(/** @type {HTMLElement} */ (event.target)));
  });
}

/** @param {HTMLElement} button */
function copy(button) {
  const code = element("v-command");
  getSelection()?.selectAllChildren(code);
  navigator.clipboard?.writeText(code.textContent ?? "").then(() => (button.textContent = "Copied"), () => undefined);
}

/** What came out of the comparison that is looked at. */
function overview() {
  const now = comparison(state);
  const one = now?.comparison;
  if (!now || !one) return '<p class="soft">These two were not compared in this pass; differences are shown all the same.</p>';
  const rows = [
    [one.edge ? "largest error, edges included" : "largest error", one.max === null ? "–" : brief(number(one.max))],
    ["interior pixels", `${one.interior}, ${one.interior_over} over tolerance`],
    ["edge pixels", `${one.edge}, ${one.edge_over} over tolerance`],
    ["worst interior pixel", one.ratio === null ? "–" : `${brief(number(one.ratio))} × its tolerance of ${brief(number(one.tolerance))}`],
  ];
  const reason = one.reason ? `<p class="reason">${escaped(one.reason)}</p>` : "";
  return `${reason}${causes(state, now.pair)}<table class="values"><tbody>${rows.map(([name, text]) => `<tr><th>${name}</th><td>${text}</td></tr>`).join("")}</tbody></table><details><summary>Scene file</summary><pre>${escaped(state.scene.text)}</pre></details>`;
}

/**
 * @param {HTMLSelectElement} select
 * @param {[string, string][]} options value and text
 * @param {string} chosen
 */
function fill(select, options, chosen) {
  const key = JSON.stringify(options);
  if (select.dataset.options !== key) {
    select.dataset.options = key;
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
  }
  select.value = chosen;
}

let listed = "";

/** Everything around the picture. */
function controls() {
  const { scene } = state;
  const now = comparison(state);
  const bad = (/** @type {string} */ name) => now?.pair.passes[name] && !now.pair.passes[name].ok;
  // A shadow is of a light.
  const titled = (/** @type {string} */ name) => (/^shadow\.L\d+$/.test(name) ? `${name} ${scene.lights[Number(name.slice(8))] ?? ""}` : name);
  fill(passSelect, passesOf(scene).map((name) => [name, bad(name) ? `${titled(name)} ✗` : titled(name)]), state.pass);
  const names = scene.renderers.map((renderer, place) => /** @type {[string, string]} */ ([String(place), renderer.name]));
  fill(aSelect, names, String(state.a));
  fill(bSelect, names, String(state.b));
  const one = now?.comparison;
  const text = one ? (one.ok ? "agrees" : "differs") : "not compared";
  const mark = one ? (one.ok ? "✓" : "✗") : "–";
  element("v-state").innerHTML = `<span class="chip ${one ? (one.ok ? "ok" : "bad") : "none"}" title="${escaped(one?.reason ?? "")}"><span aria-hidden="true">${mark}</span> ${text}</span>`;
  for (const button of element("v-modes").querySelectorAll("button")) {
    button.setAttribute("aria-pressed", String(button.dataset.mode === state.mode));
    if (button.dataset.mode === "flipmap") {
      button.title = withoutFlip();
      button.setAttribute("aria-disabled", String(button.title !== ""));
    }
  }
  exposure.value = String(state.exposure);
  exposure.disabled = !scene.floats || rowOf(state.pass).quantity !== "color";
  element("v-stops").textContent = `${state.exposure > 0 ? "+" : ""}${state.exposure}`;
  clipBox.checked = state.clip;
  edgesBox.checked = state.edges;
  clipBox.disabled = edgesBox.disabled = !scene.floats;
  element("v-kinds").innerHTML = state.edges && scene.floats ? KINDS.map(sample).join("") : "";
  const filters = [state.find, state.failed, state.onlyPass, state.onlyRenderer].join("\n");
  if (listed !== filters) {
    listed = filters;
    fillList(state, list, element("v-count"), choose);
    search.value = state.find;
    failedBox.checked = state.failed;
    filterPass.value = state.onlyPass;
    filterRenderer.value = state.onlyRenderer;
  }
  markScene(state, list);
}

/** @param {import("viewer/outlines.js").Kind} kind */
function sample(kind) {
  const line = `<line x1="0" x2="26" y1="5" y2="5"`;
  return `<span><svg width="26" height="10" aria-hidden="true"><rect width="26" height="10" fill="#000"/>${line} stroke="${kind.color}" stroke-width="2" stroke-dasharray="${kind.dash.join(" ")}"/></svg> ${kind.name}</span>`;
}

/** @param {Mode} mode */
function setMode(mode) {
  if (mode === "flipmap" && withoutFlip()) {
    element("v-how").textContent = withoutFlip();
    return;
  }
  if (mode === "flip" && state.mode === "flip") change({ flipped: !state.flipped });
  else change({ mode, flipped: false });
}

/** @param {number} step */
function stepScene(step) {
  direction = step;
  const scenes = filtered(state).map((entry) => entry.scene);
  const at = scenes.indexOf(state.scene);
  const next = scenes[at < 0 ? 0 : Math.max(0, Math.min(scenes.length - 1, at + step))];
  if (next) choose(next);
}

/** @param {number} step */
function stepPass(step) {
  const names = passesOf(state.scene);
  const next = names[names.indexOf(state.pass) + step];
  if (next) change({ pass: next, exposure: 0 });
}

/**
 * @param {number} dx
 * @param {number} dy
 */
function stepPixel(dx, dy) {
  const [columns, rows] = state.scene.size;
  const [x, y] = state.pixel ?? hovered ?? [Math.floor(columns / 2), Math.floor(rows / 2)];
  goTo([Math.max(0, Math.min(columns - 1, x + dx)), Math.max(0, Math.min(rows - 1, y + dy))], state.zoom);
}

/**
 * To a pixel, which comes into sight.
 * @param {[number, number]} pixel
 * @param {number} zoom
 */
function goTo(pixel, zoom) {
  const canvas = stage.canvases[0];
  const scale = zoom || stage.scale();
  const [halfX, halfY] = canvas ? [canvas.clientWidth / 2 / scale, canvas.clientHeight / 2 / scale] : [1e9, 1e9];
  const [cx, cy] = stage.centre();
  const away = Math.abs(pixel[0] + 0.5 - cx) > halfX - 1 || Math.abs(pixel[1] + 0.5 - cy) > halfY - 1;
  change({ pixel, zoom, centre: zoom && away ? [pixel[0] + 0.5, pixel[1] + 0.5] : [cx, cy] });
}

/** @param {string} text why nothing happens */
function say(text) {
  element("v-how").textContent = text;
}

function goToWorst() {
  const one = comparison(state)?.comparison;
  const place = one?.worst;
  if (!one) say("these two were not compared in this pass: there is no worst pixel");
  else if (!place || number(one.max) === 0) say("there is no worst pixel: nothing differs");
  else change({ pixel: [place.x, place.y], zoom: 16, centre: [place.x + 0.5, place.y + 0.5] });
}

/** @param {number} step */
function stepVerdict(step) {
  const found = comparison(state)?.pair.verdicts ?? [];
  const at = found.findIndex((one) => one.x === state.pixel?.[0] && one.y === state.pixel?.[1]);
  const next = found[(Math.max(at, step > 0 ? -1 : 0) + step + found.length) % found.length];
  if (next) goTo([next.x, next.y], state.zoom);
  else say("no pixel of these two was judged");
}

/** @type {Record<string, () => void>} */
const KEYS = {
  b: () => setMode("side"),
  s: () => setMode("slider"),
  f: () => setMode("flip"),
  d: () => setMode("diff"),
  h: () => setMode("heat"),
  m: () => setMode("flipmap"),
  v: () => setMode("verdict"),
  x: () => change({ a: state.b, b: state.a }),
  o: () => change({ edges: !state.edges && state.scene.floats }),
  c: () => change({ clip: !state.clip }),
  e: () => change({ exposure: Math.min(16, state.exposure + 0.5) }),
  E: () => change({ exposure: Math.max(-8, state.exposure - 0.5) }),
  ",": () => change({ split: Math.max(0, state.split - 0.02) }),
  ".": () => change({ split: Math.min(1, state.split + 0.02) }),
  w: goToWorst,
  n: () => stepVerdict(1),
  p: () => stepVerdict(-1),
  "+": () => stage.zoomBy(ZOOM_STEP, state.pixel && [state.pixel[0] + 0.5, state.pixel[1] + 0.5]),
  "=": () => KEYS["+"](),
  "-": () => stage.zoomBy(1 / ZOOM_STEP, state.pixel && [state.pixel[0] + 0.5, state.pixel[1] + 0.5]),
  0: () => change({ zoom: 0 }),
  "?": () => help.showModal(),
  "/": () => search.focus(),
};

/** @type {Record<string, [number, number]>} */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** @param {KeyboardEvent} event */
function onKey(event) {
  if (viewer.hidden || event.ctrlKey || event.metaKey || event.altKey || summary.open || help.open) return;
  const target = /** @type {HTMLElement} */ (event.target);
  const typing = target.matches("input:not([type=checkbox]), select, textarea");
  const inside = target === stageElement;
  if (event.key === "Escape") {
    if (typing || inside) target.blur();
    if (state.pixel && !typing) change({ pixel: null });
    return;
  }
  if (typing) return;
  const arrow = ARROWS[event.key];
  if (arrow) {
    const step = event.shiftKey ? 10 : 1;
    // Elsewhere the arrows are for scrolling.
    if (!inside && target.closest("#v-inspector, .low, .top")) return;
    if (inside) stepPixel(arrow[0] * step, arrow[1] * step);
    else if (arrow[1]) stepScene(arrow[1]);
    else stepPass(arrow[0]);
  } else if (event.key === "Enter" && (target === document.body || target.closest("#v-scenes"))) {
    if (target !== document.body) return;
    stageElement.focus();
  } else if (/^[1-9]$/.test(event.key)) {
    const name = passesOf(state.scene)[Number(event.key) - 1];
    if (name) change({ pass: name, exposure: 0 });
  } else if (Object.hasOwn(KEYS, event.key)) KEYS[event.key]();
  else return;
  event.preventDefault();
}

/** Whether the address is of the report in plain words: what is no address of the viewer is an anchor there. */
function plainly() {
  const target = location.hash.startsWith("#/") ? null : document.querySelector(":target");
  return location.hash === "#report" || (target !== null && report.contains(target));
}

/** Which of the two is shown, and what. */
function route() {
  known = location.hash;
  const plain = plainly();
  viewer.hidden = plain;
  report.hidden = !plain;
  document.documentElement.classList.remove("opening");
  document.documentElement.classList.toggle("viewing", !plain);
  if (plain) return;
  summary.close();
  // Back from the report, where one was.
  if (location.hash !== "#/" || !stageElement.dataset.ready) state = fromAddress(location.hash);
  addressed = state.scene.key;
  void draw();
}

/**
 * Buttons that lead to what other commands found, where there is some.
 * @param {HTMLElement} place
 */
function parts(place) {
  return [...place.querySelectorAll("section.included")].map((section) => {
    const button = Object.assign(document.createElement("button"), { type: "button" });
    button.textContent = section.querySelector("h2")?.textContent ?? "";
    button.addEventListener("click", () => section.scrollIntoView());
    return button;
  });
}

function begin() {
  if (!run.scenes.length) return;
  const every = [...new Set(run.scenes.flatMap(passesOf))];
  const renderers = [...new Set(run.scenes.flatMap((scene) => scene.renderers.map((renderer) => renderer.name)))];
  fill(filterPass, [["", "all"], ...every.map((name) => /** @type {[string, string]} */ ([name, name]))], "");
  fill(filterRenderer, [["", "all"], ...renderers.map((name) => /** @type {[string, string]} */ ([name, name]))], "");
  search.addEventListener("input", () => change({ find: search.value }));
  failedBox.addEventListener("change", () => change({ failed: failedBox.checked }));
  filterPass.addEventListener("change", () => {
    const name = filterPass.value;
    change({ onlyPass: name, ...(name && passesOf(state.scene).includes(name) ? { pass: name } : {}) });
  });
  filterRenderer.addEventListener("change", () => change({ onlyRenderer: filterRenderer.value }));
  passSelect.addEventListener("change", () => change({ pass: passSelect.value, exposure: 0 }));
  aSelect.addEventListener("change", () => change({ a: Number(aSelect.value) }));
  bSelect.addEventListener("change", () => change({ b: Number(bSelect.value) }));
  element("v-swap").addEventListener("click", () => KEYS.x());
  for (const button of element("v-modes").querySelectorAll("button")) {
    button.addEventListener("click", () => setMode(/** @type {Mode} */ (button.dataset.mode)));
  }
  element("v-in").addEventListener("click", () => KEYS["+"]());
  element("v-out").addEventListener("click", () => KEYS["-"]());
  element("v-fit").addEventListener("click", () => KEYS[0]());
  exposure.addEventListener("input", () => change({ exposure: Number(exposure.value) }));
  clipBox.addEventListener("change", () => change({ clip: clipBox.checked }));
  edgesBox.addEventListener("change", () => change({ edges: edgesBox.checked }));
  element("v-worst").addEventListener("click", goToWorst);
  element("v-help-open").addEventListener("click", () => help.showModal());
  element("v-summary-open").addEventListener("click", () => {
    const place = element("v-matrix");
    if (!place.firstChild) {
      place.innerHTML = matrix();
      element("v-parts").append(...parts(place));
    }
    summary.showModal();
  });
  const back = Object.assign(document.createElement("a"), { href: "#/", textContent: "Viewer" });
  report.querySelector(".kicker")?.append(" · ", back);
  addEventListener("keydown", onKey);
  addEventListener("hashchange", route);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => stage.redraw());
  document.documentElement.classList.add("scripted");
  route();
}

begin();
