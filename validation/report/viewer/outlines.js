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
  const set = (/** @type {number} */ x, /** @type {number} */ y) => {
    if (x < 0 || y < 0 || x >= columns || y >= rows) return false;
    const flag = flags[y * columns + x];
    return (flag & bit) !== 0 && (flag & others) === 0;
  };
  const path = new Path2D();
  let any = false;
  const runs = (/** @type {number} */ lines, /** @type {number} */ length, /** @type {boolean} */ across) => {
    for (let line = 0; line <= lines; line++) {
      let start = -1;
      for (let at = 0; at <= length; at++) {
        const border =
          at < length && (across ? set(at, line) !== set(at, line - 1) : set(line, at) !== set(line - 1, at));
        if (border && start < 0) start = at;
        if (!border && start >= 0) {
          any = true;
          path.moveTo(across ? start : line, across ? line : start);
          path.lineTo(across ? at : line, across ? line : at);
          start = -1;
        }
      }
    }
  };
  runs(rows, columns, true);
  if (!any) return null;
  runs(columns, rows, false);
  return path;
}
