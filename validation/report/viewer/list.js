// The list of scenes with filters, and the matrix of all of them.
import { number, passesOf, run, variant } from "viewer/data.js";
import { brief, escaped } from "viewer/inspector.js";
import { address, initial, worst } from "viewer/state.js";

/** @typedef {import("viewer/state.js").State} State */

/**
 * The folders that all names begin with.
 * @param {string[]} labels
 */
export function sharedFolder(labels) {
  let shared = labels[0]?.slice(0, labels[0].lastIndexOf("/") + 1) ?? "";
  while (shared && !labels.every((label) => label.startsWith(shared))) {
    shared = shared.slice(0, shared.slice(0, -1).lastIndexOf("/") + 1);
  }
  return shared;
}

const folder = sharedFolder(run.scenes.map((scene) => scene.label));

/** @typedef {{ made: number, differ: number, wrong: number, worst: Comparison | null, pass: string, ratio: number, excused: number }} Result */

/**
 * What came out of a scene, of the passes and renderers that are asked for.
 * @param {SceneEntry} scene
 * @param {string} onlyPass
 * @param {string} onlyRenderer
 * @returns {Result}
 */
export function result(scene, onlyPass, onlyRenderer) {
  /** @type {Result} */
  const found = { made: 0, differ: 0, wrong: 0, worst: null, pass: "", ratio: -1, excused: 0 };
  const wrong = new Set();
  const excused = new Set();
  for (const pair of scene.pairs) {
    const names = [pair.a, pair.b].map((place) => scene.renderers[place].name);
    if (onlyRenderer && !names.includes(onlyRenderer)) continue;
    for (const [name, one] of Object.entries(pair.passes)) {
      if (onlyPass && name !== onlyPass) continue;
      found.made += 1;
      found.differ += one.ok ? 0 : 1;
      const ratio = one.ratio === null ? -1 : number(one.ratio);
      if (ratio > found.ratio || (!one.ok && found.worst?.ok)) {
        if (found.worst && !found.worst.ok && one.ok) continue;
        [found.ratio, found.worst, found.pass] = [ratio, one, name];
      }
    }
    for (const verdict of pair.verdicts) {
      if (!verdict.explained && (!onlyPass || verdict.passes.includes(onlyPass))) wrong.add(`${verdict.x},${verdict.y}`);
      else if (verdict.explained && (!onlyPass || verdict.passes.includes(onlyPass))) excused.add(`${verdict.x},${verdict.y}`);
    }
    if (!onlyPass) for (const pixel of pair.unproved) wrong.add(pixel.join());
  }
  found.wrong = wrong.size;
  found.excused = excused.size;
  return found;
}

/** @param {Result} found */
function told(found) {
  // Worst is the interior pixel nearest to its tolerance, or farthest beyond: errors of lengths and colours are no match.
  const tolerance = number(found.worst?.tolerance ?? null);
  const off = tolerance > 0 ? `${brief(found.ratio * tolerance)}, ${brief(found.ratio)} × its tolerance` : "";
  const worst = found.worst?.max === 0 ? "no difference" : found.worst ? `worst: ${found.pass}, off by ${off || brief(number(found.worst.max))}` : "";
  if (!found.made) return { bad: false, chip: "not compared", worst: "" };
  const edges = found.excused ? `${worst}; ${found.excused} ${found.excused === 1 ? "pixel" : "pixels"} off at edges, explained` : worst;
  if (found.differ) return { bad: true, chip: `${found.differ} of ${found.made} differ`, worst };
  if (found.wrong) return { bad: true, chip: `${found.wrong} ${found.wrong === 1 ? "pixel" : "pixels"} unexplained or wrong`, worst };
  return { bad: false, chip: `all ${found.made} agree`, worst: edges };
}

/**
 * Where the picture of a scene is.
 * @param {SceneEntry} scene
 */
export function thumbnail(scene) {
  for (const pair of scene.pairs) {
    const key = (pair.passes.beauty ?? Object.values(pair.passes)[0])?.picture_a;
    if (key) return pictureAddress(key);
  }
  return "data:,";
}

/**
 * The address of a picture of the page: an id, or the address itself.
 * @param {string} key
 */
export function pictureAddress(key) {
  if (key.startsWith("data:")) return key;
  return /** @type {HTMLImageElement | null} */ (document.getElementById(key))?.src ?? "data:,";
}

/**
 * The scenes that pass the filters, failures first.
 * @param {State} state
 */
export function filtered(state) {
  const words = state.find.toLowerCase().split(/\s+/).filter(Boolean);
  return run.scenes
    .map((scene) => ({ scene, found: result(scene, state.onlyPass, state.onlyRenderer) }))
    .filter(({ scene, found }) => {
      const bad = found.differ > 0 || found.wrong > 0;
      const text = `${scene.label} ${scene.size.join("x")} ${scene.as} ${scene.spheres.join(" ")}`.toLowerCase();
      return found.made > 0 && (bad || !state.failed) && words.every((word) => text.includes(word));
    })
    .sort((a, b) => rank(a.found) - rank(b.found));
}

/** @param {Result} found */
function rank(found) {
  return found.differ ? 0 : found.wrong ? 1 : 2;
}

/**
 * What a scene is called in the list: with its size, or the convention it was drawn by, where there are two.
 * @param {SceneEntry} scene
 */
function called(scene) {
  const double = run.scenes.some((other) => other.label === scene.label && other.size.join() !== scene.size.join());
  return scene.label.slice(folder.length) + (double ? ` ${scene.size.join("×")}` : "") + variant(scene);
}

/**
 * @param {State} state
 * @param {HTMLElement} list
 * @param {HTMLElement} count
 * @param {(scene: SceneEntry) => void} choose
 */
export function fillList(state, list, count, choose) {
  const shown = filtered(state);
  count.textContent = `${shown.length === run.scenes.length ? "" : `${shown.length} of `}${run.scenes.length} ${run.scenes.length === 1 ? "scene" : "scenes"}${folder ? ` in ${folder}` : ""}`;
  list.replaceChildren(
    ...shown.map(({ scene, found }) => {
      const { bad, chip, worst } = told(found);
      const item = document.createElement("li");
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.scene = scene.key;
      const name = called(scene);
      button.innerHTML = `<img alt="" loading="lazy" src="${thumbnail(scene)}"><span><b>${escaped(name).replace(/[/-]/g, "$&<wbr>")}</b><span class="chip ${bad ? "bad" : "ok"}"><span aria-hidden="true">${bad ? "✗" : "✓"}</span> ${chip}</span><span class="soft">${escaped(worst)}</span></span>`;
      button.addEventListener("click", () => choose(scene));
      item.append(button);
      return item;
    }),
  );
}

/**
 * Marks the scene that is looked at.
 * @param {State} state
 * @param {HTMLElement} list
 */
export function markScene(state, list) {
  const buttons = [...list.querySelectorAll("button")];
  const chosen = buttons.find((button) => button.dataset.scene === state.scene.key) ?? buttons[0];
  for (const button of buttons) {
    const here = button.dataset.scene === state.scene.key;
    button.tabIndex = button === chosen ? 0 : -1; // one stop on the way through the page: arrow keys go on from there
    if (here) button.setAttribute("aria-current", "true");
    else button.removeAttribute("aria-current");
    if (here) button.scrollIntoView({ block: "nearest" });
  }
}

/**
 * An error over its tolerance, as short as in the tables of the report in plain words.
 * @param {number} ratio
 */
function short(ratio) {
  if (ratio === 0) return "0";
  if (ratio < 0.01) return "<.01";
  if (ratio < 0.995) return ratio.toFixed(2).replace(/^0/, "");
  if (ratio < 1.005 && ratio !== 1) return ratio < 1 ? "<1" : ">1"; // rounded, it would read as 1 on either side
  return brief(ratio);
}

/** What other commands found, as the report in plain words has it. */
function plots() {
  return document.getElementById("included")?.innerHTML ?? "";
}

/** Scenes and pairs by passes; every cell leads to its comparison. */
export function matrix() {
  const every = [...new Set(run.scenes.flatMap(passesOf))];
  const rows = filtered(initial()).flatMap(({ scene }) =>
    scene.pairs.map((pair, place) => {
      const cells = every.map((name) => {
        const one = pair.passes[name];
        if (!one) return '<td class="none">–</td>';
        const state = { ...initial(), ...worst(scene), pass: name, a: pair.a, b: pair.b };
        state.pixel = one.worst ? [one.worst.x, one.worst.y] : null;
        const ratio = one.ratio === null ? "–" : short(number(one.ratio));
        const sign = `<span aria-hidden="true">${one.ok ? "✓" : "✗"}</span><span class="sr">${one.ok ? "agrees" : "differs"}</span>`;
        return `<td class="${one.ok ? "ok" : "bad"}"><a href="${escaped(address(state))}" title="${escaped(`${name}: ${one.reason ?? "agrees"}`)}">${sign} ${ratio}</a></td>`;
      });
      const head = place ? "" : `<th scope="rowgroup" rowspan="${scene.pairs.length}">${escaped(called(scene))}</th>`;
      const names = [pair.a, pair.b].map((place) => escaped(scene.renderers[place].name)).join("<br>");
      return `<tr>${head}<th scope="row">${names}</th>${cells.join("")}</tr>`;
    }),
  );
  const heads = every.map((name) => `<th scope="col">${escaped(name).replace(/\./g, ".<wbr>")}</th>`).join("");
  const versions = Object.entries(run.versions).map(([name, value]) => `<tr><th scope="row">${escaped(name)}</th><td>${escaped(value)}</td></tr>`);
  return `<p class="soft">Error of the worst interior pixel over its tolerance; up to 1 the two agree. Every cell leads to its comparison.</p><div class="wide" tabindex="0" role="region" aria-label="all comparisons"><table class="summary"><thead><tr><th scope="col">scene</th><th scope="col">renderers</th>${heads}</tr></thead><tbody>${rows.join("")}</tbody></table></div><h3>Repeat it with</h3><p><code class="command">${escaped(run.command)}</code></p><details><summary>Versions</summary><table class="plain">${versions.join("")}</table></details>${plots()}`;
}
