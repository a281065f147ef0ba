// From values to colours: passes, errors, signed differences.

/** @typedef {{ pixels: ImageData, how: string }} Picture */
/** @typedef {{ from: number[], to: number[] }} Range */

/** Inferno, dark to bright: perceptually uniform, so that larger errors are brighter. */
const INFERNO = [
  [22, 11, 57], [66, 10, 104], [106, 23, 110], [147, 38, 103], [188, 55, 84],
  [221, 81, 58], [243, 120, 25], [252, 165, 10], [246, 215, 70], [252, 255, 164],
];

/** That of FLIP, as its authors show it. */
const MAGMA = [
  [0, 0, 4], [24, 15, 61], [68, 15, 118], [114, 31, 129], [158, 47, 127],
  [205, 64, 113], [241, 96, 93], [253, 150, 104], [254, 202, 141], [252, 253, 191],
];

/** The first ten colours of matplotlib, of spheres. */
const SPHERES = [
  [31, 119, 180], [255, 127, 14], [44, 160, 44], [214, 39, 40], [148, 103, 189],
  [140, 86, 75], [227, 119, 194], [127, 127, 127], [188, 189, 34], [23, 190, 207],
];

/** Factors of ten that the scale of errors shows below the largest. */
export const DECADES = 6;

/**
 * A colour of the scale of errors.
 * @param {number} share from 0 to 1
 * @returns {number[]}
 */
export function inferno(share) {
  return between(INFERNO, share);
}

/**
 * A colour of the scale of FLIP.
 * @param {number} share from 0 to 1
 * @returns {number[]}
 */
export function magma(share) {
  return between(MAGMA, share);
}

/**
 * @param {number[][]} colors at equal distances
 * @param {number} share
 */
function between(colors, share) {
  const place = Math.max(0, Math.min(1, share)) * (colors.length - 1);
  const at = Math.min(colors.length - 2, Math.floor(place));
  return colors[at].map((value, channel) => value + (place - at) * (colors[at + 1][channel] - value));
}

/**
 * A colour of a signed difference: blue below 0, orange above, black at 0.
 * @param {number} share from -1 to 1
 * @returns {number[]}
 */
export function signed(share) {
  const strength = Math.abs(share);
  const full = share > 0 ? [255, 176, 60] : [96, 176, 255];
  const dark = share > 0 ? [92, 40, 0] : [0, 34, 104];
  return strength === 0 ? [0, 0, 0] : full.map((value, channel) => dark[channel] + strength * (value - dark[channel]));
}

/**
 * The smallest and largest value of each channel in all planes, of those that count.
 * @param {Plane[]} planes
 * @param {(Plane | null)[]} ids where they are below 0 there is nothing
 * @returns {Range}
 */
export function range(planes, ids) {
  const channels = planes[0].channels;
  const [from, to] = [Array(channels).fill(Infinity), Array(channels).fill(-Infinity)];
  planes.forEach((plane, side) => {
    const count = plane.values.length / channels;
    const hit = ids[side]?.values;
    for (let c = 0; c < channels; c++) {
      for (let i = 0; i < count; i++) {
        const value = plane.values[c * count + i];
        if (!isFinite(value) || (hit && hit[i] < 0)) continue;
        if (value < from[c]) from[c] = value;
        if (value > to[c]) to[c] = value;
      }
    }
  });
  return { from, to };
}

/**
 * By how much a pass without light in its name is brightened, in stops, so that something shows.
 * @param {PassRow} row
 * @param {Range} limits
 */
export function brightened(row, limits) {
  const largest = Math.max(...limits.to);
  if (row.quantity !== "color" || row.name === "beauty" || !(largest > 0 && largest <= 0.5)) return 0;
  return -Math.ceil(Math.log2(largest));
}

/**
 * One pass as a picture.
 * @param {PassRow} row
 * @param {Plane} plane
 * @param {Plane | null} ids of the same renderer
 * @param {Range} limits of both renderers
 * @param {[number, number]} size
 * @param {number} stops
 * @param {boolean} clip mark what is below 0 or above 1
 * @returns {ImageData}
 */
export function picture(row, plane, ids, limits, size, stops, clip) {
  const pixels = new ImageData(size[0], size[1]);
  const data = pixels.data;
  const { values, channels } = plane;
  const count = size[0] * size[1];
  const gain = 2 ** stops;
  const hit = ids?.values;
  const stretch = limits.to.map((to, c) => (to > limits.from[c] ? to - limits.from[c] : 1));
  const shown = [0, 0, 0];
  for (let i = 0; i < count; i++) {
    let see = 255;
    let wrong = false;
    for (let c = 0; c < 3; c++) {
      const value = values[(channels === 3 ? c : 0) * count + i];
      wrong ||= value !== value || (!isFinite(value) && row.quantity !== "length");
      if (row.quantity === "color") shown[c] = value * gain;
      else if (row.quantity === "normal") shown[c] = 0.5 + 0.5 * value;
      else if (row.quantity === "position") shown[c] = (value - limits.from[c]) / stretch[c];
      else if (row.quantity === "length") shown[c] = 1 - (0.9 * (value - limits.from[0])) / stretch[0];
      else shown[c] = value;
    }
    if (row.quantity === "id") {
      const id = values[i];
      see = id < 0 ? 0 : 255;
      const color = SPHERES[Math.max(0, id) % 10];
      for (let c = 0; c < 3; c++) shown[c] = color[c] / 255;
    } else if (row.quantity === "length") see = isFinite(values[i]) ? 255 : 0;
    else if (hit && hit[i] < 0 && (row.quantity === "position" || row.quantity === "normal")) see = 0;
    const at = 4 * i;
    if (wrong) {
      data.set([255, 0, 255, 255], at);
      continue;
    }
    for (let c = 0; c < 3; c++) data[at + c] = Math.trunc(Math.max(0, Math.min(1, shown[c])) * 255);
    data[at + 3] = see;
    if (clip && row.quantity === "color") {
      const over = shown[0] > 1 || shown[1] > 1 || shown[2] > 1;
      const under = shown[0] < 0 || shown[1] < 0 || shown[2] < 0;
      const [x, y] = [i % size[0], Math.floor(i / size[0])];
      // Stripes one way above 1, the other way below 0.
      if (over && (x + y) % 3 === 0) data.set([255, 0, 160, 255], at);
      if (under && (x - y + 3 * size[1]) % 3 === 0) data.set([0, 200, 255, 255], at);
    }
  }
  return pixels;
}

/**
 * The error of every pixel, NaN where nothing is compared, and the difference of the channel that differs most.
 * @param {PassRow} row
 * @param {Plane} a
 * @param {Plane} b
 * @param {(i: number) => boolean} compared
 * @returns {{ errors: Float64Array, signs: Float64Array }}
 */
export function differences(row, a, b, compared) {
  const count = a.values.length / a.channels;
  const [errors, signs] = [new Float64Array(count), new Float64Array(count)];
  for (let i = 0; i < count; i++) {
    if (!compared(i)) {
      errors[i] = signs[i] = NaN;
      continue;
    }
    let [largest, sign, squares] = [0, 0, 0];
    for (let c = 0; c < a.channels; c++) {
      const [one, other] = [a.values[c * count + i], b.values[c * count + i]];
      let apart = one === other ? 0 : one - other;
      if (apart !== apart) apart = Infinity;
      squares += apart * apart;
      if (Math.abs(apart) > largest) [largest, sign] = [Math.abs(apart), apart];
    }
    errors[i] = row.quantity === "normal" ? Math.sqrt(squares) : largest;
    signs[i] = sign;
  }
  return { errors, signs };
}

/**
 * The same of errors that were measured before.
 * @param {Float32Array} from
 * @param {boolean} turned whether A and B have changed places
 * @param {(i: number) => boolean} compared
 * @returns {{ errors: Float64Array, signs: Float64Array }}
 */
export function measured(from, turned, compared) {
  const signs = Float64Array.from(from, (value, i) => (compared(i) ? (turned ? -value : value) : NaN));
  return { errors: signs.map(Math.abs), signs };
}

/**
 * The exponents of ten between which errors are shown: those of the interior, so that one edge pixel hides nothing.
 * @param {Float64Array} errors
 * @param {(i: number) => boolean} edge
 * @returns {[number, number] | null} null: there is no error
 */
export function decades(errors, edge) {
  let found = false;
  /** @type {number[]} */
  const ends = [Infinity, 0, Infinity, 0];
  for (let i = 0; i < errors.length; i++) {
    const error = errors[i];
    if (!(error > 0)) continue;
    found = true;
    if (error === Infinity) continue;
    const at = edge(i) ? 2 : 0;
    if (error < ends[at]) ends[at] = error;
    if (error > ends[at + 1]) ends[at + 1] = error;
  }
  if (!found) return null;
  const [least, most] = ends[1] > 0 ? ends : ends.slice(2);
  if (!(most > 0)) return [-1, 0];
  const top = Math.ceil(Math.log10(most));
  return [Math.max(top - DECADES, Math.min(Math.floor(Math.log10(least)), top - 1)), top];
}

/**
 * Errors, or signed differences, as a picture on a logarithmic scale; see-through where nothing is compared.
 * @param {Float64Array} values
 * @param {[number, number] | null} scale exponents of ten
 * @param {[number, number]} size
 * @param {boolean} both whether the sign shows
 * @returns {ImageData}
 */
export function logarithmic(values, scale, size, both) {
  const pixels = new ImageData(size[0], size[1]);
  for (let i = 0; i < values.length; i++) {
    const value = values[i];
    if (value !== value) continue;
    let color = [0, 0, 0];
    if (value !== 0 && scale) {
      const share = (Math.log10(Math.abs(value)) - scale[0]) / (scale[1] - scale[0]);
      // What is below all decades is noise beside the rest.
      if (share >= 0) color = both ? signed(Math.sign(value) * Math.max(0.02, Math.min(1, share))) : inferno(Math.min(1, share));
    }
    pixels.data[4 * i] = color[0];
    pixels.data[4 * i + 1] = color[1];
    pixels.data[4 * i + 2] = color[2];
    pixels.data[4 * i + 3] = 255;
  }
  return pixels;
}
