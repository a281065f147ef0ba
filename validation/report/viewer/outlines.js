// Outlines of edge pixels, one a kind of margin, each with its colour and its line.

/** @typedef {{ name: string, bit: number, color: string, dash: number[] }} Kind */

/**
 * @param {Record<string, number>} kinds the bits of the page's maps
 * @returns {Kind[]}
 */
export function styles(kinds) {
  /** @type {[string, number[]][]} */
  const looks = [["#2ee6ff", []], ["#ffd23f", [6, 3]], ["#ff8ae2", [1.5, 2.5]], ["#9dff6a", [8, 3, 1.5, 3]]];
  const named = Object.entries(kinds).map(([name, bit], place) => {
    const [color, dash] = looks[place % looks.length];
    return { name, bit, color, dash };
  });
  return [...named, { name: "no bound", bit: 4, color: "#ffffff", dash: [12, 4] }];
}

/**
 * The border of all pixels with a bit, in pixels of the picture; null where there are none.
 * @param {Uint8Array} flags
 * @param {number} bit
 * @param {[number, number]} size
 * @param {number} others bits that a pixel must not have
 * @returns {Path2D | null}
 */
export function outline(flags, bit, size, others = 0) {
  const [columns, rows] = size;
  // With a frame of pixels without it.
  const wide = columns + 2;
  const set = new Uint8Array(wide * (rows + 2));
  let any = false;
  for (let y = 0, i = 0; y < rows; y++) {
    for (let x = 0; x < columns; x++, i++) {
      if ((flags[i] & bit) === 0 || (flags[i] & others) !== 0) continue;
      set[(y + 1) * wide + x + 1] = 1;
      any = true;
    }
  }
  if (!any) return null;
  const path = new Path2D();
  const runs = (/** @type {number} */ lines, /** @type {number} */ length, /** @type {boolean} */ across) => {
    const [step, back] = across ? [1, wide] : [wide, 1];
    for (let line = 0; line <= lines; line++) {
      let start = -1;
      let place = across ? (line + 1) * wide + 1 : wide + line + 1;
      for (let at = 0; at <= length; at++, place += step) {
        const border = at < length && set[place] !== set[place - back];
        if (border && start < 0) start = at;
        if (!border && start >= 0) {
          path.moveTo(across ? start : line, across ? line : start);
          path.lineTo(across ? at : line, across ? line : at);
          start = -1;
        }
      }
    }
  };
  runs(rows, columns, true);
  runs(columns, rows, false);
  return path;
}
