/** Faces with the same material, from the model file. Colours are in sRGB, from 0 to 1. */
export interface Patch {
  positions: Float32Array;
  /** Three indices per face; null if the vertices are in order. */
  indices: Uint32Array | null;
  /** Three numbers per vertex. */
  colours: Float32Array | null;
  /** Two numbers per vertex. 0 is the first row of the picture. */
  uvs: Float32Array | null;
  image: ImageBitmap | null;
  /** The factor for the colours of vertices and texture. */
  colour: Colour;
}

export type Colour = [number, number, number];
export type Up = "y" | "z";

/** The original appearance of a model: its faces with colours and textures. */
export interface Appearance {
  patches: Patch[];
  /** The up axis, if the format defines one. */
  up: Up | null;
}

/** Returns a sidecar file of a model, such as a texture or a material library; null if it is missing. */
export type Beside = (name: string) => Promise<Uint8Array | null>;

export const WHITE: Colour = [1, 1, 1];

/** Whether a file has any colours. */
export function isColoured({ patches }: Appearance): boolean {
  return patches.some(({ colours, image, colour }) => colours !== null || image !== null || colour.some((part) => part < 0.995));
}

/** Converts a linear colour, as in glTF, to sRGB. */
export function fromLinear(part: number): number {
  const x = Math.min(1, Math.max(0, part));
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/** Collects triangles of one material with unshared vertices. */
export class PatchBuilder {
  readonly #positions: number[] = [];
  readonly #colours: number[] = [];
  readonly #uvs: number[] = [];

  constructor(
    readonly colour: Colour = WHITE,
    readonly image: ImageBitmap | null = null,
  ) {}

  /** Adds a vertex. Either all vertices of a patch have a colour or none; the same holds for texture coordinates. */
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

/** Decodes a picture; null if the browser cannot decode it. */
export async function readImage(bytes: Uint8Array, type: string): Promise<ImageBitmap | null> {
  return createImageBitmap(new Blob([bytes.slice()], { type }), { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch(() => null);
}

/** The media type of a picture by its extension. */
export function imageType(name: string): string {
  return /\.jpe?g$/i.test(name) ? "image/jpeg" : /\.webp$/i.test(name) ? "image/webp" : "image/png";
}
