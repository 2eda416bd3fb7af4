/** Faces of one look, as a model's own file has them. Colours are in sRGB, from 0 to 1. */
export interface Patch {
  positions: Float32Array;
  /** Three vertices a face; without it the vertices come in this order. */
  indices: Uint32Array | null;
  /** Three numbers a vertex. */
  colours: Float32Array | null;
  /** Two numbers a vertex. The first row of the picture is at 0. */
  uvs: Float32Array | null;
  image: ImageBitmap | null;
  /** What the colours of vertices and picture are multiplied by. */
  colour: Colour;
}

export type Colour = [number, number, number];
export type Up = "y" | "z";

/** How a model looks by its own file: its faces with their colours and pictures. */
export interface Appearance {
  patches: Patch[];
  /** Which axis is up, where the format says so. */
  up: Up | null;
}

/** The file beside a model's file, such as a picture or a list of materials; none where there is no such file. */
export type Beside = (name: string) => Promise<Uint8Array | null>;

export const WHITE: Colour = [1, 1, 1];

/** Whether a file says any colour at all. */
export function isColoured({ patches }: Appearance): boolean {
  return patches.some(({ colours, image, colour }) => colours !== null || image !== null || colour.some((part) => part < 0.995));
}

/** A linear colour, as glTF has it, in sRGB. */
export function fromLinear(part: number): number {
  const x = Math.min(1, Math.max(0, part));
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/** Collects triangles of one look whose corners are not shared. */
export class PatchBuilder {
  readonly #positions: number[] = [];
  readonly #colours: number[] = [];
  readonly #uvs: number[] = [];

  constructor(
    readonly colour: Colour = WHITE,
    readonly image: ImageBitmap | null = null,
  ) {}

  /** Adds a corner. Either all corners of a patch have a colour or none, and so with places in the picture. */
  add(position: ArrayLike<number>, colour: ArrayLike<number> | null = null, uv: ArrayLike<number> | null = null): void {
    this.#positions.push(position[0]!, position[1]!, position[2]!);
    if (colour) this.#colours.push(colour[0]!, colour[1]!, colour[2]!);
    if (uv) this.#uvs.push(uv[0]!, uv[1]!);
  }

  build(): Patch | null {
    const count = this.#positions.length / 3;
    if (count === 0) return null;
    const uvs = this.#uvs.length === 2 * count ? Float32Array.from(this.#uvs) : null;
    return {
      positions: Float32Array.from(this.#positions),
      indices: null,
      colours: this.#colours.length === 3 * count ? Float32Array.from(this.#colours) : null,
      uvs,
      image: uvs ? this.image : null,
      colour: this.colour,
    };
  }
}

/** A picture of a file; none where the browser can't read it. */
export async function readImage(bytes: Uint8Array, type: string): Promise<ImageBitmap | null> {
  return createImageBitmap(new Blob([bytes.slice()], { type }), { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch(() => null);
}

/** The media type of a picture by the ending of its name. */
export function imageType(name: string): string {
  return /\.jpe?g$/i.test(name) ? "image/jpeg" : /\.webp$/i.test(name) ? "image/webp" : "image/png";
}
