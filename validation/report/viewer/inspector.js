// One pixel: every value of every renderer, the differences, margins, what is proved, and the command that repeats it.
import { number, pairOf, rowOf, run } from "viewer/data.js";
import { markSvg, who } from "viewer/marks.js";
import { address } from "viewer/state.js";

/** @typedef {import("viewer/state.js").State} State */

/**
 * Text for the page.
 * @param {string} text
 */
export function escaped(text) {
  return text.replace(/[&<>"']/g, (sign) => `&#${sign.charCodeAt(0)};`);
}

/**
 * The shortest digits that are this number and no other.
 * @param {number} value
 * @param {boolean} narrow of float32
 */
export function digits(value, narrow) {
  if (value === Infinity) return "∞";
  if (value === -Infinity) return "-∞";
  if (Object.is(value, -0)) return "-0";
  if (narrow) {
    for (let count = 1; count < 10; count++) {
      const text = value.toPrecision(count);
      if (Math.fround(Number(text)) === value) return String(Number(text));
    }
  }
  return Number.isNaN(value) ? "not a number" : String(value);
}

/**
 * A measured number.
 * @param {number} value
 */
export function brief(value) {
  if (value === 0) return "0";
  if (!isFinite(value)) return Number.isNaN(value) ? "–" : value > 0 ? "∞" : "-∞";
  const size = Math.abs(value);
  if (size >= 0.01 && size < 1e5) return String(Number(value.toPrecision(3)));
  return value.toExponential(1).replace("e+", "e").replace(".0e", "e");
}

const buffer = new DataView(new ArrayBuffer(8));

/**
 * Its place among all float32.
 * @param {number} value
 */
function place32(value) {
  buffer.setFloat32(0, value);
  const bits = buffer.getInt32(0);
  return bits < 0 ? -2147483648 - bits : bits;
}

/**
 * Its place among all float64.
 * @param {number} value
 */
function place64(value) {
  buffer.setFloat64(0, value);
  const bits = buffer.getBigInt64(0);
  return bits < 0n ? -(2n ** 63n) - bits : bits;
}

/**
 * How many numbers lie between two: of float64 if both are, else of float32.
 * @param {number} a
 * @param {number} b
 * @param {boolean} wide
 */
export function ulps(a, b, wide) {
  if (Number.isNaN(a) || Number.isNaN(b)) return NaN;
  return wide ? Number(place64(a) - place64(b)) : place32(Math.fround(a)) - place32(Math.fround(b));
}

/**
 * The level of an 8-bit image.
 * @param {number} value
 * @param {boolean} narrow
 */
export function level(value, narrow) {
  const held = value > 0 ? (value < 1 ? value : 1) : 0;
  return Math.trunc(narrow ? Math.fround(held * 255) : held * 255);
}

/** As much as the curve of a program in float32 may be off by, as when it is compared. */
const CURVE_ROUNDINGS = 8 * 2 ** -24;

/**
 * The levels that a colour may have in an image: of a curve, and halfway between two, the program has the choice.
 * @param {number} value
 * @param {Encoding} encoding
 * @returns {number[]}
 */
export function levels(value, { quantisation, steps }) {
  const held = value > 0 ? (value < 1 ? value : 1) : 0;
  const scale = quantisation === "255.9" ? steps + 0.9 : quantisation === "256" ? steps + 1 : steps;
  const offset = ["round", "srgb", "gamma"].includes(quantisation) ? 0.5 : 0;
  const at = (/** @type {number} */ curve) => Math.max(0, Math.min(steps, Math.floor(scale * curve + offset)));
  if (/^(srgb|gamma)/.test(quantisation)) {
    const srgb = held <= 0.0031308 ? 12.92 * held : 1 - 1.055 * (1 - held ** (1 / 2.4));
    const curve = quantisation.startsWith("srgb") ? srgb : held ** (1 / 2.2);
    return [at(curve), at(curve - CURVE_ROUNDINGS), at(curve + CURVE_ROUNDINGS)];
  }
  const up = at(held);
  const half = quantisation === "round" && held > 0 && held < 1 && (held * steps) % 1 === 0.5;
  return half && up % 2 ? [up, up - 1] : [up];
}

/**
 * @typedef {Object} Seen
 * @property {State} state
 * @property {[number, number]} pixel
 * @property {string[]} passes
 * @property {(place: number, pass: string) => Plane | null | undefined} plane undefined: not there yet
 * @property {Float32Array | null} margins
 * @property {number} flag of the comparison
 */

/**
 * The digits that two texts do not begin with alike are set apart.
 * @param {string} text
 * @param {string} other
 */
function apart(text, other) {
  let same = 0;
  while (same < text.length && text[same] === other[same]) same += 1;
  if (same === text.length && text === other) return escaped(text);
  return `${escaped(text.slice(0, same))}<b>${escaped(text.slice(same))}</b>`;
}

/**
 * @param {Seen} seen
 * @param {string} name of the pass
 */
function passTable(seen, name) {
  const { state, pixel } = seen;
  const { scene } = state;
  const row = rowOf(name);
  const at = pixel[1] * scene.size[0] + pixel[0];
  const count = scene.size[0] * scene.size[1];
  const channels = row.channels || " ";
  const truth = scene.truths[pixel.join(",")]?.[name];
  let body = "";
  let rounded = false;
  const encoded = [state.a, state.b].find((place) => scene.renderers[place].encoding);
  const encoding = row.name === "beauty" && encoded !== undefined ? scene.renderers[encoded].encoding : null;
  const order = [state.a, state.b, ...scene.renderers.keys()].filter((place, i, all) => all.indexOf(place) === i);
  [...channels].forEach((channel, c) => {
    // All are held against the exact value, where it is known, else against A.
    /** @type {{ value: number, wide: boolean } | null} */
    let first = null;
    const exact = truth ? number(truth[c]) : NaN;
    if (truth) {
      first = { value: exact, wide: true };
      body += `<tr class="truth"><th>${channel}</th><th>exact</th><td>${digits(exact, false)}</td><td></td><td></td><td></td>${row.name === "beauty" ? `<td>${level(exact, false)}</td>` : ""}</tr>`;
    }
    for (const place of order) {
      const renderer = scene.renderers[place];
      const plane = seen.plane(place, name);
      if (plane === null) continue;
      const letter = place === state.a ? "A" : place === state.b ? "B" : "";
      const head = `<th>${first ? "" : channel}</th><th scope="row" title="${escaped(renderer.name)}">${letter ? `<i>${letter}</i> ` : ""}${escaped(renderer.name)}</th>`;
      if (!plane) {
        body += `<tr>${head}<td class="soft">…</td><td></td><td></td><td></td></tr>`;
        continue;
      }
      const stored = renderer.passes[name];
      const kept = renderer.exact[pixel.join(",")]?.[name];
      const value = kept ? number(kept[c]) : plane.values[c * count + at];
      const sure = plane.exact || kept !== undefined;
      const wide = stored.wide && sure;
      const text = digits(value, !wide);
      rounded ||= !sure;
      const shown = `${sure ? "" : "≈ "}${first ? apart(text, digits(wide ? first.value : Math.fround(first.value), !wide)) : escaped(text)}`;
      const data = `data-renderer="${escaped(renderer.name)}" data-pass="${name}" data-channel="${channel.trim()}"`;
      let rest = "<td></td><td></td><td></td>";
      if (first && row.quantity !== "id" && row.quantity !== "visibility") {
        const difference = value === first.value ? 0 : value - first.value;
        const both = wide && first.wide;
        const between = Math.abs(ulps(value, first.value, both));
        const relative = Math.abs(difference) / Math.abs(first.value);
        rest = `<td>${brief(difference)}</td><td>${difference ? brief(relative) : "0"}</td><td title="numbers of float${both ? 64 : 32} apart">${brief(between)}${between && both ? "<sub>64</sub>" : ""}</td>`;
      } else if (first && value !== first.value) rest = '<td colspan="3"><b>differs</b></td>';
      const own = renderer.encoding;
      let eight = "";
      if (row.name === "beauty" && own) eight = `<td>${Math.round(value * own.steps)}</td>`;
      else if (encoding && encoded !== undefined) {
        // Where the program has the choice, its own is right.
        const there = seen.plane(encoded, name)?.values[c * count + at] ?? NaN;
        const may = levels(value, encoding);
        eight = `<td>${may.find((one) => one === Math.round(there * encoding.steps)) ?? may[0]}</td>`;
      } else if (row.name === "beauty") eight = `<td>${level(value, !wide)}</td>`;
      body += `<tr${letter ? ' class="pair"' : ""}>${head}<td class="value" title="${value}" ${data}>${shown}${meaning(scene, row, value)}</td>${rest}${eight}</tr>`;
      first ??= { value, wide };
    }
  });
  const bits = encoding && encoding.steps !== 255 ? `of ${encoding.steps}` : "8-bit";
  const eight = row.name === "beauty" ? `<th title="${escaped(encoding?.says ?? "v * 255, truncated")}">${bits}</th>` : "";
  const from = truth ? "the exact value" : "the value of A";
  const note = rounded ? '<p class="soft">≈ float64, rounded to the nearest float32 to keep the page small</p>' : "";
  return `<table class="values"><thead><tr><th colspan="2">${escaped(name)}</th><th>value</th><th title="less ${from}">− ${truth ? "exact" : "A"}</th><th title="over ${from}">relative</th><th title="floating-point numbers between it and ${from}">ulp</th>${eight}</tr></thead><tbody>${body}</tbody></table>${note}`;
}

/**
 * @param {SceneEntry} scene
 * @param {PassRow} row
 * @param {number} value
 */
function meaning(scene, row, value) {
  if (row.quantity === "id") return ` <span class="soft">${value < 0 ? "nothing" : escaped(scene.spheres[value] ?? "")}</span>`;
  if (row.quantity === "visibility") return ` <span class="soft">${value ? "visible" : "hidden"}</span>`;
  return "";
}

/**
 * @param {Finding} finding
 * @param {string} letter
 */
function sentence(finding, letter) {
  const label = finding.right ? "right" : run.causes[finding.cause] ?? finding.cause;
  const errors = Object.entries(finding.errors).map(([name, error]) => `${name} by ${brief(number(error))}`);
  const off = errors.length && !finding.says.startsWith("is off") ? ` Off in ${errors.join(", ")}.` : "";
  const says = finding.right ? "is within what it claims of the exact value." : `${finding.says}.${off}`;
  return `<p><span class="chip ${finding.explained ? "ok" : "bad"}"><span aria-hidden="true">${finding.explained ? "✓" : "✗"}</span> ${escaped(label)}</span> <b>${letter ? `${letter} ` : ""}${escaped(finding.renderer)}</b> ${escaped(says)}${finding.because && !finding.right ? `<br><span class="soft">${escaped(finding.because)}</span>` : ""}</p>`;
}

/**
 * Whether a cause is told alike for all pixels that have it.
 * @param {Finding} finding
 */
function general(finding) {
  return finding.cause === "mistake" || finding.cause === "rule";
}

/**
 * What the judged pixels of a pair come to, the most frequent first.
 * @param {State} state
 * @param {Pair} pair
 */
export function causes(state, pair) {
  /** @type {Map<string, { finding: Finding, verdict: Verdict, count: number }>} */
  const found = new Map();
  for (const verdict of pair.verdicts) {
    for (const finding of verdict.findings.filter((one) => !one.right)) {
      const key = [finding.renderer, finding.cause, general(finding) ? finding.because : ""].join("\n");
      const entry = found.get(key) ?? { finding, verdict, count: 0 };
      entry.count += 1;
      found.set(key, entry);
    }
  }
  const order = [...found.values()].sort((a, b) => Number(a.finding.explained) - Number(b.finding.explained) || b.count - a.count);
  const lines = order.slice(0, 4).map(({ finding, verdict, count }) => {
    const { explained, cause, renderer } = finding;
    const link = address({ ...state, pixel: [verdict.x, verdict.y], zoom: 0 });
    const because = count === 1 || general(finding) ? `: ${finding.because}` : "";
    return `<p><span class="chip ${explained ? "ok" : "bad"}"><span aria-hidden="true">${explained ? "✓" : "✗"}</span> ${escaped(run.causes[cause] ?? cause)}</span> ${count} × <b>${escaped(renderer)}</b> ${escaped(finding.says)}<span class="soft">${escaped(because)}</span> (${count > 1 ? "e.g. " : ""}<a href="${escaped(link)}">x ${verdict.x}, y ${verdict.y}</a>)</p>`;
  });
  return lines.length ? `<section class="verdict${order[0].finding.explained ? "" : " alarm"}"><h3>The pixels that were judged</h3>${lines.join("")}</section>` : "";
}

/**
 * The way to the judged pixel that is nearest.
 * @param {State} state
 * @param {Pair} pair
 * @param {[number, number]} pixel
 */
function nearest(state, pair, pixel) {
  const away = (/** @type {Verdict} */ one) => Math.hypot(one.x - pixel[0], one.y - pixel[1]);
  const best = pair.verdicts.reduce((found, one) => (away(one) < away(found) ? one : found));
  const link = address({ ...state, pixel: [best.x, best.y], centre: [best.x + 0.5, best.y + 0.5] });
  return `The nearest of these: <a href="${escaped(link)}">x ${best.x}, y ${best.y}</a>.`;
}

/** @param {Verdict} verdict */
function allowed(verdict) {
  const bounds = Object.entries(verdict.tolerances).map(([name, bound]) => `${name} ${isFinite(number(bound)) ? brief(number(bound)) : "without a bound"}`);
  return `<p class="soft">${verdict.edge ? "At this edge they" : "They"} may differ by: ${escaped(bounds.join(", "))}.</p>`;
}

/** @param {Seen} seen */
function verdicts(seen) {
  const { state, pixel } = seen;
  const { scene } = state;
  const found = pairOf(scene, state.a, state.b);
  let text = "";
  const own = found?.pair.verdicts.find((one) => one.x === pixel[0] && one.y === pixel[1]);
  if (own) {
    const letters = found?.turned ? ["B", "A"] : ["A", "B"];
    const said = own.findings.map((finding, side) => sentence(finding, letters[side])).join("");
    text += `<section class="verdict${own.explained ? "" : " alarm"}"><h3>${markSvg(who(own), !own.explained)} Verdict <span class="soft">${own.edge ? "edge" : "interior"} pixel</span></h3>${said}${allowed(own)}</section>`;
  } else if (found?.pair.unproved.some(([x, y]) => x === pixel[0] && y === pixel[1])) {
    text += '<section class="verdict alarm"><h3>No verdict</h3><p>The exact value of this pixel could not be had, so nobody knows which of the two is off.</p></section>';
  } else if (found && seen.flag & 2) {
    const why = found.pair.verdicts.length ? `not among the pixels judged in this run. ${nearest(state, found.pair, pixel)} The command below judges this one` : "no pixel was judged";
    text += `<p class="soft">Over tolerance in ${escaped(state.pass)}; ${why}.</p>${causes(state, found.pair)}`;
  }
  const others = scene.pairs.filter((pair) => pair !== found?.pair);
  for (const pair of others) {
    const verdict = pair.verdicts.find((one) => one.x === pixel[0] && one.y === pixel[1]);
    if (!verdict) continue;
    const names = `${scene.renderers[pair.a].name}, ${scene.renderers[pair.b].name}`;
    const said = verdict.findings.map((finding) => sentence(finding, "")).join("");
    text += `<details><summary>Verdict on ${escaped(names)}</summary>${said}</details>`;
  }
  return text;
}

/**
 * The values of A and B at a pixel, and its verdict, in one sentence.
 * @param {State} state
 * @param {[number, number]} pixel
 * @param {(place: number) => Plane | null | undefined} plane of the pass that is shown
 */
export function spoken(state, pixel, plane) {
  const { scene } = state;
  const count = scene.size[0] * scene.size[1];
  const at = pixel[1] * scene.size[0] + pixel[0];
  const sides = [state.a, state.b].map((place, side) => {
    const found = plane(place);
    const numbers = found ? Array.from({ length: found.channels }, (_, c) => brief(found.values[c * count + at])) : ["no value"];
    return `${"AB"[side]} ${scene.renderers[place].name} ${numbers.join(" ")}`;
  });
  const own = pairOf(scene, state.a, state.b)?.pair.verdicts.find((one) => one.x === pixel[0] && one.y === pixel[1]);
  const said = own?.findings.map(({ renderer, right, cause, says }) => `${renderer} ${right ? "is right" : `${says}, ${run.causes[cause] ?? cause}`}`);
  return `x ${pixel[0]}, y ${pixel[1]}, ${state.pass}: ${sides.join("; ")}${said ? `. ${said.join("; ")}` : ""}`;
}

/** @param {Seen} seen */
function marginTable(seen) {
  const { scene } = seen.state;
  if (!seen.margins) return "";
  const count = scene.size[0] * scene.size[1];
  const at = seen.pixel[1] * scene.size[0] + seen.pixel[0];
  const cells = scene.margins.map((kind, k) => {
    const bit = run.kinds[kind] ?? 0;
    const edge = seen.flag & bit ? ' <span class="chip none">edge</span>' : "";
    return `<tr><th scope="row">${kind}</th><td>${brief(seen.margins?.[k * count + at] ?? NaN)}${edge}</td></tr>`;
  });
  return `<h3>Margins</h3><p class="soft">The relative change of ray and scene that flips a decision; at an edge it is less than A or B can tell in ${escaped(seen.state.pass)}.</p><table class="values margins"><tbody>${cells.join("")}</tbody></table>`;
}

/**
 * A word of a command line.
 * @param {string} word
 */
function quoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\"'\"'")}'`;
}

/**
 * The command that tells the story of a pixel.
 * @param {State} state
 * @param {[number, number]} pixel
 */
export function command(state, pixel) {
  const { scene } = state;
  const names = [state.a, state.b].map((place) => scene.renderers[place].name).filter((name, place, all) => !/^image(:|$)/.test(name) && all.indexOf(name) === place);
  const where = scene.path === "<stdin>" ? "-" : scene.path;
  const words = ["whitted", "explain", quoted(where), String(pixel[0]), String(pixel[1])];
  // Of commands one option each, as a comma may belong to a command.
  const commands = names.filter((name) => name.startsWith("cmd:"));
  const plain = names.filter((name) => !name.startsWith("cmd:"));
  for (const list of new Set([plain.join(","), ...commands])) if (list) words.push("--renderer", quoted(list));
  return [...words, scene.options].filter(Boolean).join(" ");
}

/**
 * @param {Seen} seen
 * @returns {string}
 */
export function inspect(seen) {
  const { state } = seen;
  const others = seen.passes.filter((name) => name !== state.pass);
  const missing = state.scene.floats
    ? ""
    : `<p class="missing">${run.small ? "This report was made with <code>--small</code>" : "To keep the page small"}: it has no float values, pictures alone. The command has them.</p>`;
  const tables = state.scene.floats
    ? `${passTable(seen, state.pass)}${marginTable(seen)}<h3>All passes</h3>${others.map((name) => passTable(seen, name)).join("")}`
    : "";
  return `${verdicts(seen)}<div class="repeat"><code id="v-command">${escaped(command(state, seen.pixel))}</code><button type="button" id="v-copy">Copy</button></div>${missing}${tables}`;
}
