// The pictures on the screen: one or two canvases that zoom and move together, with outlines, marks and the pixel.
import { drawMark } from "viewer/marks.js";

/** @typedef {import("viewer/outlines.js").Kind} Kind */
/** @typedef {{ kind: Kind, path: Path2D }} Outline */

/**
 * @typedef {Object} Pane
 * @property {string} title
 * @property {CanvasImageSource} image
 * @property {CanvasImageSource} [right] what stands to the right of the slider
 * @property {boolean} [grey] whether the picture steps back behind marks
 * @property {Float64Array} [signs] signed differences, written as + and - where pixels are large
 */

/**
 * @typedef {Object} View
 * @property {[number, number]} size
 * @property {string} about what all panes show
 * @property {Pane[]} panes
 * @property {Outline[]} outlines
 * @property {Verdict[]} verdicts
 * @property {[number, number] | null} pixel
 * @property {number} zoom 0: fit
 * @property {[number, number]} centre
 * @property {number} split
 */

/**
 * @typedef {Object} Actions
 * @property {(pixel: [number, number] | null) => void} hover
 * @property {(pixel: [number, number]) => void} pick
 * @property {(zoom: number, centre: [number, number]) => void} move
 * @property {(split: number) => void} split
 * @property {() => void} resize
 */

export const MOST_ZOOM = 128;

export class Stage {
  /**
   * @param {HTMLElement} element
   * @param {Actions} actions
   */
  constructor(element, actions) {
    this.element = element;
    this.actions = actions;
    /** @type {View | null} */
    this.view = null;
    /** @type {HTMLCanvasElement[]} */
    this.canvases = [];
    this.asked = 0;
    new ResizeObserver(() => {
      this.redraw();
      actions.resize();
    }).observe(element);
  }

  /** @param {View} view */
  show(view) {
    this.view = view;
    const titles = view.panes.map((pane) => pane.title);
    if (this.canvases.length !== titles.length) this.build(titles.length);
    this.canvases.forEach((canvas, place) => {
      const caption = /** @type {HTMLElement} */ (canvas.nextElementSibling);
      caption.textContent = titles[place];
      canvas.setAttribute("aria-label", `${view.about}: ${titles[place]}`);
    });
    this.redraw();
  }

  /** @param {number} count */
  build(count) {
    this.element.replaceChildren();
    this.canvases = [];
    for (let place = 0; place < count; place++) {
      const figure = document.createElement("figure");
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      figure.append(canvas, document.createElement("figcaption"));
      this.element.append(figure);
      this.canvases.push(canvas);
      this.listen(canvas);
    }
  }

  /** Pixels of the screen for one of the picture. */
  scale() {
    const view = this.view;
    const canvas = this.canvases[0];
    if (!view || !canvas) return 1;
    if (view.zoom) return view.zoom;
    const fit = Math.min(canvas.clientWidth / view.size[0], canvas.clientHeight / view.size[1]);
    return Math.max(0.05, fit >= 1 ? Math.floor(fit * 8) / 8 : fit);
  }

  /** @returns {[number, number]} */
  centre() {
    if (!this.view) return [0, 0];
    return this.view.zoom ? this.view.centre : [this.view.size[0] / 2, this.view.size[1] / 2];
  }

  redraw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = 0;
      this.draw();
    });
  }

  draw() {
    const view = this.view;
    if (!view) return;
    const ratio = devicePixelRatio;
    const sizes = this.canvases.map((canvas) => [canvas.clientWidth, canvas.clientHeight]);
    this.canvases.forEach((canvas, place) => {
      const [width, height] = sizes[place];
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const context = canvas.getContext("2d");
      if (context) this.paint(context, view, view.panes[place], width, height, ratio);
    });
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {View} view
   * @param {Pane} pane
   * @param {number} width
   * @param {number} height
   * @param {number} ratio
   */
  paint(context, view, pane, width, height, ratio) {
    const scale = this.scale();
    const [cx, cy] = this.centre();
    const [left, top] = [Math.round(width / 2 - cx * scale), Math.round(height / 2 - cy * scale)];
    const [wide, high] = [view.size[0] * scale, view.size[1] * scale];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    checks(context, left, top, wide, high, width, height);
    context.imageSmoothingEnabled = scale < 1;
    const border = Math.round(view.split * width);
    if (pane.grey) context.filter = "grayscale(1) brightness(0.45)";
    if (pane.right) {
      for (const [image, from, until] of /** @type {[CanvasImageSource, number, number][]} */ ([
        [pane.image, 0, border],
        [pane.right, border, width],
      ])) {
        context.save();
        context.beginPath();
        context.rect(from, 0, until - from, height);
        context.clip();
        context.drawImage(image, left, top, wide, high);
        context.restore();
      }
    } else context.drawImage(pane.image, left, top, wide, high);
    context.filter = "none";
    if (pane.signs && scale >= 16) this.signs(context, view, pane.signs, left, top, scale, width, height);
    for (const { kind, path } of view.outlines) {
      context.save();
      context.translate(left, top);
      context.scale(scale, scale);
      context.lineWidth = 3.5 / scale;
      context.strokeStyle = "rgb(0 0 0 / 0.75)";
      context.stroke(path);
      context.setLineDash(kind.dash.map((length) => length / scale));
      context.lineWidth = 1.6 / scale;
      context.strokeStyle = kind.color;
      context.stroke(path);
      context.restore();
    }
    for (const verdict of view.verdicts) {
      const half = Math.max(5, 0.35 * scale);
      drawMark(context, verdict, left + (verdict.x + 0.5) * scale, top + (verdict.y + 0.5) * scale, half);
    }
    if (view.pixel) ring(context, left + view.pixel[0] * scale, top + view.pixel[1] * scale, scale);
    if (pane.right) {
      context.fillStyle = "#000";
      context.fillRect(border - 2, 0, 4, height);
      context.fillStyle = "#fff";
      context.fillRect(border - 1, 0, 2, height);
      context.beginPath();
      context.arc(border, height / 2, 11, 0, 7);
      context.fill();
      context.fillStyle = "#000";
      context.font = "700 12px system-ui, sans-serif";
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText("⇔", border, height / 2);
    }
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {View} view
   * @param {Float64Array} signs
   * @param {number} left
   * @param {number} top
   * @param {number} scale
   * @param {number} width
   * @param {number} height
   */
  signs(context, view, signs, left, top, scale, width, height) {
    context.fillStyle = "#fff";
    context.font = `${Math.min(24, scale * 0.6)}px ui-monospace, monospace`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    const [columns, rows] = view.size;
    const until = (/** @type {number} */ edge, /** @type {number} */ most) => Math.min(most, Math.ceil(edge / scale));
    for (let y = Math.max(0, Math.floor(-top / scale)); y < until(height - top, rows); y++) {
      for (let x = Math.max(0, Math.floor(-left / scale)); x < until(width - left, columns); x++) {
        const sign = signs[y * columns + x];
        if (sign) context.fillText(sign > 0 ? "+" : "−", left + (x + 0.5) * scale, top + (y + 0.5) * scale);
      }
    }
  }

  /**
   * The pixel of the picture under a pointer.
   * @param {HTMLCanvasElement} canvas
   * @param {MouseEvent} event
   * @returns {[number, number]} with fractions
   */
  under(canvas, event) {
    const box = canvas.getBoundingClientRect();
    const [scale, [cx, cy]] = [this.scale(), this.centre()];
    const left = Math.round(box.width / 2 - cx * scale);
    const top = Math.round(box.height / 2 - cy * scale);
    return [(event.clientX - box.left - left) / scale, (event.clientY - box.top - top) / scale];
  }

  /**
   * @param {number} factor
   * @param {[number, number] | null} around a place of the picture that stays where it is
   */
  zoomBy(factor, around) {
    const before = this.scale();
    const after = Math.max(0.25, Math.min(MOST_ZOOM, before * factor));
    const [cx, cy] = this.centre();
    const [x, y] = around ?? [cx, cy];
    const keep = before / after;
    this.actions.move(after, [x + (cx - x) * keep, y + (cy - y) * keep]);
  }

  /** @param {HTMLCanvasElement} canvas */
  listen(canvas) {
    /** @type {{ x: number, y: number, centre: [number, number], moved: boolean, split: boolean } | null} */
    let held = null;
    const inside = (/** @type {MouseEvent} */ event) => {
      const [x, y] = this.under(canvas, event).map(Math.floor);
      const [columns, rows] = this.view?.size ?? [0, 0];
      return x >= 0 && y >= 0 && x < columns && y < rows ? /** @type {[number, number]} */ ([x, y]) : null;
    };
    const nearSplit = (/** @type {MouseEvent} */ event) => {
      const pane = this.view?.panes[this.canvases.indexOf(canvas)];
      if (!pane?.right || !this.view) return false;
      const box = canvas.getBoundingClientRect();
      return Math.abs(event.clientX - box.left - this.view.split * box.width) < 14;
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      held = { x: event.clientX, y: event.clientY, centre: this.centre(), moved: false, split: nearSplit(event) };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (held?.split) {
        const box = canvas.getBoundingClientRect();
        this.actions.split(Math.max(0, Math.min(1, (event.clientX - box.left) / box.width)));
      } else if (held) {
        const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
        held.moved ||= Math.abs(dx) + Math.abs(dy) > 4;
        const scale = this.scale();
        if (held.moved) this.actions.move(scale, [held.centre[0] - dx / scale, held.centre[1] - dy / scale]);
      } else {
        canvas.style.cursor = nearSplit(event) ? "ew-resize" : "crosshair";
        this.actions.hover(inside(event));
      }
    });
    canvas.addEventListener("pointerup", (event) => {
      const pixel = inside(event);
      if (held && !held.moved && !held.split && pixel) this.actions.pick(pixel);
      held = null;
    });
    canvas.addEventListener("pointercancel", () => (held = null));
    canvas.addEventListener("pointerleave", () => this.actions.hover(null));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoomBy(2 ** (-event.deltaY / 240), this.under(canvas, event));
      },
      { passive: false },
    );
  }
}

/**
 * What shows through where there is nothing.
 * @param {CanvasRenderingContext2D} context
 * @param {number} left
 * @param {number} top
 * @param {number} wide
 * @param {number} high
 * @param {number} width
 * @param {number} height
 */
function checks(context, left, top, wide, high, width, height) {
  const [x, y] = [Math.max(0, left), Math.max(0, top)];
  const [right, bottom] = [Math.min(width, left + wide), Math.min(height, top + high)];
  const style = getComputedStyle(document.documentElement);
  context.fillStyle = style.getPropertyValue("--check-a");
  context.fillRect(x, y, right - x, bottom - y);
  context.fillStyle = style.getPropertyValue("--check-b");
  for (let j = 0; y + 8 * j < bottom; j++) {
    for (let i = j % 2; x + 8 * i < right; i += 2) {
      context.fillRect(x + 8 * i, y + 8 * j, Math.min(8, right - x - 8 * i), Math.min(8, bottom - y - 8 * j));
    }
  }
}

/**
 * The pixel that is looked at.
 * @param {CanvasRenderingContext2D} context
 * @param {number} x
 * @param {number} y
 * @param {number} scale
 */
function ring(context, x, y, scale) {
  context.setLineDash([]);
  const grown = scale < 12 ? (12 - scale) / 2 + 2 : 1;
  for (const [color, wide] of /** @type {[string, number][]} */ ([["#000", 4], ["#fff", 2]])) {
    context.strokeStyle = color;
    context.lineWidth = wide;
    context.strokeRect(x - grown, y - grown, scale + 2 * grown, scale + 2 * grown);
  }
}
