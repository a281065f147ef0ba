// Undoes what validation/report/floats.py did: base64, deflate, byte planes, predictions.

/** In a rest: the value is the sum of its parts. */
const IS_SUM = -(2 ** 31);

/**
 * The bytes of a block of the page.
 * @param {string} text base64 of a zlib stream
 * @returns {Promise<Uint8Array>}
 */
export async function inflate(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * `count` integers, of which the page has first all lowest bytes, then all second ones, and so on.
 * @param {Uint8Array} bytes
 * @param {number} count
 * @returns {Int32Array}
 */
export function unpack(bytes, count) {
  const found = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const zigzag = bytes[i] | (bytes[count + i] << 8) | (bytes[2 * count + i] << 16) | (bytes[3 * count + i] << 24);
    found[i] = (zigzag >>> 1) ^ -(zigzag & 1);
  }
  return found;
}

/**
 * Adds to every number the plane through its neighbours, in place.
 * @param {Int32Array} order
 * @param {number} channels
 * @param {number} columns
 * @param {number} rows
 */
export function addPlanar(order, channels, columns, rows) {
  for (let c = 0; c < channels; c++) {
    const start = c * columns * rows;
    for (let x = 1; x < columns; x++) order[start + x] += order[start + x - 1];
    for (let y = 1; y < rows; y++) {
      let i = start + y * columns;
      order[i] += order[i - columns];
      for (let x = 1; x < columns; x++) {
        i += 1;
        order[i] += order[i - 1] + order[i - columns] - order[i - columns - 1];
      }
    }
  }
}

/**
 * Adds another array of integers, in place.
 * @param {Int32Array} order
 * @param {Int32Array} other
 */
export function addOther(order, other) {
  for (let i = 0; i < order.length; i++) order[i] += other[i];
}

/**
 * From bits in the order of the numbers to the numbers, and back: the same operation.
 * @param {Int32Array} bits
 * @returns {Int32Array}
 */
export function swapOrder(bits) {
  const found = new Int32Array(bits.length);
  for (let i = 0; i < bits.length; i++) found[i] = bits[i] < 0 ? bits[i] ^ 0x7fffffff : bits[i];
  return found;
}

/**
 * The sum of arrays in this order, in float64.
 * @param {ArrayLike<number>[]} parts
 * @returns {Float64Array}
 */
export function sum(parts) {
  const total = new Float64Array(parts[0]);
  for (const part of parts.slice(1)) for (let i = 0; i < total.length; i++) total[i] += part[i];
  return total;
}

/**
 * float64 values from the nearest float32 and how many float64 farther from 0 they are.
 * @param {Float32Array} base
 * @param {Int32Array} rest
 * @param {Uint8Array} bytes the block: behind the rest stand exceptions
 * @param {Float64Array | null} sums of the parts, where they are needed
 * @returns {Float64Array}
 */
export function addRest(base, rest, bytes, sums) {
  const values = new Float64Array(base);
  const words = new Uint32Array(values.buffer); // little-endian, as every browser is
  for (let i = 0; i < rest.length; i++) {
    const step = rest[i];
    if (step === 0) continue;
    if (step === IS_SUM && sums) {
      values[i] = sums[i];
      continue;
    }
    const low = words[2 * i] + step;
    words[2 * i + 1] += Math.floor(low / 2 ** 32);
    words[2 * i] = low;
  }
  const behind = bytes.subarray(4 * rest.length);
  const count = behind.length / 12;
  const view = new DataView(behind.buffer, behind.byteOffset, behind.length);
  for (let k = 0; k < count; k++) values[view.getUint32(4 * k, true)] = view.getFloat64(4 * count + 8 * k, true);
  return values;
}

/**
 * How many float64 each value is farther from 0 than its float32.
 * @param {Float64Array} values
 * @param {Float32Array} base
 * @returns {Int32Array}
 */
export function restOf(values, base) {
  const near = new Float64Array(base);
  const [a, b] = [new Uint32Array(values.buffer, values.byteOffset), new Uint32Array(near.buffer)];
  const rest = new Int32Array(base.length);
  for (let i = 0; i < rest.length; i++) {
    // By the bit of the sign, which -0 has, too.
    if (values[i] !== values[i] || (a[2 * i + 1] ^ b[2 * i + 1]) < 0) continue;
    const far = (a[2 * i + 1] - b[2 * i + 1]) * 2 ** 32 + (a[2 * i] - b[2 * i]);
    if (Math.abs(far) < 2 ** 30) rest[i] = far;
  }
  return rest;
}

/**
 * The bits of the nearest float32, in the order of the numbers.
 * @param {Float64Array} values
 */
export function orderOf(values) {
  return swapOrder(new Int32Array(new Float32Array(values).buffer));
}

/**
 * The point of every pixel's ray at a distance from the eye.
 * @param {number[]} rays first x and step, first y and step, z
 * @param {Float32Array} depth
 * @param {number} columns
 * @param {number} rows
 */
export function points([x0, across, y0, down, z], depth, columns, rows) {
  const count = columns * rows;
  const found = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) {
    const x = x0 + across * (i % columns);
    const y = y0 + down * Math.floor(i / columns);
    const share = depth[i] / Math.sqrt(x * x + y * y + z * z);
    found[i] = finite(x * share);
    found[count + i] = finite(y * share);
    found[2 * count + i] = finite(z * share);
  }
  return found;
}

/**
 * The normals of spheres at points, towards the eye.
 * @param {number[][]} spheres centre and squared half axes
 * @param {Float32Array} places
 * @param {Float32Array} ids
 */
export function normals(spheres, places, ids) {
  const count = ids.length;
  const found = new Float64Array(3 * count);
  for (let i = 0; i < count; i++) {
    const of = spheres[ids[i]];
    if (!of) continue;
    const [px, py, pz] = [places[i], places[count + i], places[2 * count + i]];
    const x = (px - of[0]) / of[3];
    const y = (py - of[1]) / of[4];
    const z = (pz - of[2]) / of[5];
    const away = x * px + y * py + z * pz > 0;
    const length = Math.sqrt(x * x + y * y + z * z) * (away ? -1 : 1);
    found[i] = finite(x / length);
    found[count + i] = finite(y / length);
    found[2 * count + i] = finite(z / length);
  }
  return found;
}

/** @param {number} value */
function finite(value) {
  return Number.isFinite(value) ? value : 0;
}
