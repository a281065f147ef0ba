// What the page holds: the JSON at once, arrays when they are asked for.
import { addOther, addPlanar, addRest, inflate, normals, orderOf, points, restOf, sum, swapOrder, unpack } from "viewer/codec.js";

/** @type {Run} */
export const run = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("record")).textContent ?? "");

/** Scenes whose arrays are kept: what is looked at, two before and two after it, and some that were. */
const KEPT = 8;

/**
 * A number of the JSON.
 * @param {Num | null} value
 */
export function number(value) {
  if (value === null) return NaN;
  return typeof value === "number" ? value : value === "inf" ? Infinity : value === "-inf" ? -Infinity : NaN;
}

/**
 * The row of the table of passes.
 * @param {string} name
 * @returns {PassRow}
 */
export function rowOf(name) {
  const matches = (/** @type {PassRow} */ row) =>
    row.name.endsWith("*") ? name.startsWith(row.name.slice(0, -1)) : row.name === name;
  return /** @type {PassRow} */ (run.table.find(matches) ?? run.table[0]);
}

/**
 * What follows the name of a scene, where another one has the same.
 * @param {SceneEntry} scene
 */
export function variant(scene) {
  return scene.as ? ` · ${scene.as}` : "";
}

/**
 * Every pass of a scene that some renderer has, in the order of the table.
 * @param {SceneEntry} scene
 * @returns {string[]}
 */
export function passesOf(scene) {
  const names = new Set([
    ...scene.pairs.flatMap((pair) => Object.keys(pair.passes)),
    ...scene.renderers.flatMap((renderer) => Object.keys(renderer.passes)),
  ]);
  const place = (/** @type {string} */ name) => run.table.indexOf(rowOf(name));
  return [...names].sort((a, b) => place(a) - place(b) || a.localeCompare(b, "en", { numeric: true }));
}

/**
 * The comparison of two renderers of a scene, and whether it was made the other way round.
 * @param {SceneEntry} scene
 * @param {number} a
 * @param {number} b
 * @returns {{ pair: Pair, turned: boolean } | null}
 */
export function pairOf(scene, a, b) {
  for (const pair of scene.pairs) {
    if (pair.a === a && pair.b === b) return { pair, turned: false };
    if (pair.a === b && pair.b === a) return { pair, turned: true };
  }
  return null;
}

/** @typedef {{ base: Float32Array, plane: Plane }} Decoded */

/**
 * Arrays of the scenes looked at last, by scene and then by block.
 * @type {Map<string, Map<string, Promise<any>>>}
 */
const kept = new Map();

/**
 * What `make` makes, once, as long as the scene is kept.
 * @template T
 * @param {SceneEntry} scene
 * @param {string} key
 * @param {() => Promise<T>} make
 * @returns {Promise<T>}
 */
function once(scene, key, make) {
  const blocks = kept.get(scene.key) ?? new Map();
  kept.delete(scene.key);
  kept.set(scene.key, blocks);
  for (const old of kept.keys()) if (kept.size > KEPT) kept.delete(old);
  let found = blocks.get(key);
  if (!found) blocks.set(key, (found = make()));
  return found;
}

/**
 * @param {string} id
 * @returns {Promise<Uint8Array>}
 */
function block(id) {
  return inflate(document.getElementById(id)?.textContent ?? "");
}

/**
 * @param {SceneEntry} scene
 * @param {number} place of the renderer
 * @param {string} name of the pass
 * @returns {Promise<Decoded>}
 */
function decoded(scene, place, name) {
  return once(scene, `${place}-${name}`, async () => {
    const stored = scene.renderers[place].passes[name];
    const [columns, rows] = scene.size;
    const count = stored.channels * columns * rows;
    const bytes = await block(`d${scene.key}-${place}-${name}`);
    const order = unpack(bytes, count);
    const parts = await Promise.all(stored.parts.map((part) => decoded(scene, place, part)));
    const needs = stored.based || stored.prediction === "first";
    const first = needs ? await decoded(scene, 0, name) : null;
    if (stored.prediction === "planar") addPlanar(order, stored.channels, columns, rows);
    else if (stored.prediction === "first" && first) addOther(order, swapOrder(new Int32Array(first.base.buffer)));
    else if (stored.prediction === "sum") addOther(order, orderOf(sum(parts.map((part) => part.base))));
    else {
      const guides = await Promise.all(stored.guides.map((guide) => decoded(scene, place, guide)));
      const [one, other] = guides.map((guide) => guide.base);
      const ray = stored.prediction === "ray";
      addOther(order, orderOf(ray ? points(scene.rays, one, columns, rows) : normals(scene.surfaces, one, other)));
    }
    const base = new Float32Array(swapOrder(order).buffer);
    if (!stored.rest) return { base, plane: { values: base, channels: stored.channels, exact: !stored.wide } };
    const behind = await block(`x${scene.key}-${place}-${name}`);
    const rest = unpack(behind, count);
    const above = stored.based && first ? first.plane.values : null;
    if (first && above instanceof Float64Array) addOther(rest, restOf(above, first.base));
    const sums = parts.length && !stored.based ? sum(parts.map((part) => part.plane.values)) : null;
    const values = addRest(base, rest, behind, sums);
    return { base, plane: { values, channels: stored.channels, exact: scene.whole } };
  });
}

/**
 * The values of a pass; null where the page has none.
 * @param {SceneEntry} scene
 * @param {number} place of the renderer
 * @param {string} name of the pass
 * @returns {Promise<Plane | null>}
 */
export async function plane(scene, place, name) {
  if (!scene.floats || !scene.renderers[place]?.passes[name]) return null;
  return (await decoded(scene, place, name)).plane;
}

/**
 * Lets go of all that is kept of a scene but some planes, as a scene with all of its passes takes some 100 MB.
 * @param {SceneEntry} scene
 * @param {[number, string][]} wanted places of renderers, and passes
 */
export function trim(scene, wanted) {
  const names = new Set(wanted.map(([place, name]) => `${place}-${name}`));
  const blocks = kept.get(scene.key);
  for (const key of blocks?.keys() ?? []) if (/^\d/.test(key) && !names.has(key)) blocks?.delete(key);
}

/**
 * A byte for every pixel of a comparison: whether it was compared, is over tolerance, and an edge of which kind.
 * @param {SceneEntry} scene
 * @param {Comparison | undefined} comparison
 * @returns {Promise<Uint8Array | null>}
 */
export async function flags(scene, comparison) {
  if (!comparison?.flags) return null;
  return once(scene, comparison.flags, () => block(comparison.flags));
}

/**
 * The errors of `beauty` that a comparison with levels measured, positive where its A is larger.
 * @param {SceneEntry} scene
 * @param {Pair | undefined} pair
 * @returns {Promise<Float32Array | null>}
 */
export async function signedErrors(scene, pair) {
  if (!scene.floats || !pair?.signed) return null;
  return once(scene, pair.signed, async () => {
    const [columns, rows] = scene.size;
    const order = unpack(await block(pair.signed), columns * rows);
    addPlanar(order, 1, columns, rows);
    return new Float32Array(swapOrder(order).buffer);
  });
}

/**
 * The margins of a scene, kind after kind.
 * @param {SceneEntry} scene
 * @returns {Promise<Float32Array | null>}
 */
export async function margins(scene) {
  if (!scene.floats || !scene.margins.length) return null;
  return once(scene, "margins", async () => {
    const [columns, rows] = scene.size;
    const order = unpack(await block(`m${scene.key}`), scene.margins.length * columns * rows);
    addPlanar(order, scene.margins.length, columns, rows);
    return new Float32Array(swapOrder(order).buffer);
  });
}
