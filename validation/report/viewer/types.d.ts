// The shape of the JSON that validation/report/data.py writes, and what the standard library of the checker lacks.

/** A number; JSON has no token for those that are not finite. */
type Num = number | "inf" | "-inf" | "nan";

interface StoredPass {
  channels: number;
  prediction: "planar" | "first" | "sum" | "ray" | "surface";
  parts: string[];
  guides: string[];
  wide: boolean;
  based: boolean;
  rest: boolean;
}

/** How the levels of an image stand for colours. */
interface Encoding {
  quantisation: string;
  steps: number;
  says: string;
}

interface RendererEntry {
  name: string;
  /** Of its `beauty`; null: it holds colours. */
  encoding: Encoding | null;
  passes: Record<string, StoredPass>;
  exact: Record<string, Record<string, Num[]>>;
}

interface Comparison {
  ok: boolean;
  reason?: string;
  max: Num | null;
  ratio: Num | null;
  tolerance: Num | null;
  interior: number;
  interior_over: number;
  edge: number;
  edge_over: number;
  worst: { x: number; y: number; channel: string; a: Num; b: Num } | null;
  flags: string;
  picture_a?: string;
  picture_b?: string;
  picture_heat?: string;
  picture_flip?: string;
  flip?: { max: Num; mean: Num } | null;
  how?: string;
  ticks?: [number, string][];
}

type Mark = "cross" | "square" | "circle" | "both" | "dot";

interface Finding {
  renderer: string;
  right: boolean;
  cause: string;
  explained: boolean;
  says: string;
  because: string;
  errors: Record<string, Num>;
}

interface Verdict {
  x: number;
  y: number;
  edge: boolean;
  passes: string[];
  /** By pass what A and B may differ by here. */
  tolerances: Record<string, Num>;
  explained: boolean;
  findings: [Finding, Finding];
}

interface Pair {
  a: number;
  b: number;
  anchor: string;
  ok: boolean;
  /** The block with the errors of `beauty` that were measured, where A or B is levels; else empty. */
  signed: string;
  passes: Record<string, Comparison>;
  differ: number;
  verdicts: Verdict[];
  /** Pixels that truth could not be had of. */
  unproved: [number, number][];
}

interface SceneEntry {
  key: string;
  label: string;
  /** Where it is, which may be called otherwise. */
  path: string;
  size: [number, number];
  /** What tells it from others with the same label and size, as drawn with other settings; empty: there are none. */
  as: string;
  text: string;
  spheres: string[];
  lights: string[];
  options: string;
  margins: string[];
  rays: [number, number, number, number, number];
  surfaces: number[][];
  floats: boolean;
  whole: boolean;
  renderers: RendererEntry[];
  pairs: Pair[];
  truths: Record<string, Record<string, Num[]>>;
}

interface PassRow {
  name: string;
  channels: string;
  quantity: "color" | "visibility" | "length" | "position" | "normal" | "id" | "margin";
}

interface Run {
  command: string;
  versions: Record<string, string>;
  small: boolean;
  causes: Record<string, string>;
  kinds: Record<string, number>;
  table: PassRow[];
  scenes: SceneEntry[];
}

/** One pass of one renderer, channel after channel: value i of channel c of n pixels stands at c * n + i. */
interface Plane {
  values: Float32Array | Float64Array;
  channels: number;
  /** Whether these are the renderer's own numbers, and not float64 rounded to float32. */
  exact: boolean;
}

interface DecompressionStream {
  readonly readable: ReadableStream<Uint8Array>;
  readonly writable: WritableStream<Uint8Array>;
}
declare var DecompressionStream: { new (format: "deflate" | "deflate-raw" | "gzip"): DecompressionStream };
