// Marks of verdicts: a shape and a colour for who is off.

/** @type {Record<Mark, { color: string, says: (a: string, b: string) => string }>} */
export const MARKS = {
  cross: { color: "#ff5c8a", says: () => "crossed: unexplained, or a known mistake" },
  square: { color: "#ffb000", says: (a) => `${a} is off` },
  circle: { color: "#2ee6ff", says: (_, b) => `${b} is off` },
  both: { color: "#b6ff3c", says: () => "both are off" },
  dot: { color: "#ffffff", says: () => "neither is off by more than it claims" },
};

/**
 * Their outlines, from -1 to 1.
 * @type {Record<Mark, string>}
 */
const SHAPES = {
  cross: "M-1 -1L1 1M-1 1L1 -1",
  square: "M-1 -1H1V1H-1Z",
  circle: "M-1 0a1 1 0 1 0 2 0a1 1 0 1 0 -2 0Z",
  both: "M-1 -1H1V1H-1ZM-1 0a1 1 0 1 0 2 0a1 1 0 1 0 -2 0Z",
  dot: "M-.3 0a.3 .3 0 1 0 .6 0a.3 .3 0 1 0 -.6 0Z",
};

/**
 * Who is off at a pixel, whatever the reason.
 * @param {Verdict} verdict
 * @returns {Mark}
 */
export function who(verdict) {
  const [a, b] = verdict.findings;
  return a.right ? (b.right ? "dot" : "circle") : b.right ? "square" : "both";
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Verdict} verdict
 * @param {number} x
 * @param {number} y
 * @param {number} half from its middle to its side
 */
export function drawMark(context, verdict, x, y, half) {
  const mark = who(verdict);
  const path = new Path2D();
  path.addPath(new Path2D(SHAPES[mark]), new DOMMatrix([half, 0, 0, half, x, y]));
  const inside = 0.5 * half;
  if (!verdict.explained) path.addPath(new Path2D(SHAPES.cross), new DOMMatrix([inside, 0, 0, inside, x, y]));
  context.setLineDash([]);
  context.strokeStyle = "#000";
  context.lineWidth = 4.5;
  context.stroke(path);
  context.strokeStyle = MARKS[mark].color;
  context.lineWidth = 2;
  context.stroke(path);
}

/**
 * The same as an element of the page.
 * @param {Mark} mark
 * @param {boolean} [crossed]
 */
export function markSvg(mark, crossed = false) {
  const cross = crossed ? "M-.5 -.5L.5 .5M-.5 .5L.5 -.5" : "";
  const path = `<path d="${SHAPES[mark]}${cross}" vector-effect="non-scaling-stroke"/>`;
  return `<svg class="sign" viewBox="-1.5 -1.5 3 3" aria-hidden="true"><g class="m ${mark}">${path}${path}</g></svg>`;
}
