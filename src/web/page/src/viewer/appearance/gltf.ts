import { Matrix4, Quaternion, Vector3 } from "three";
import { type Appearance, type Beside, type Colour, type Patch, WHITE, fromLinear, imageType, readImage } from "./appearance";

interface Accessor {
  bufferView?: number;
  byteOffset?: number;
  componentType: number;
  normalized?: boolean;
  count: number;
  type: string;
}

interface Primitive {
  attributes: Record<string, number>;
  indices?: number;
  material?: number;
  mode?: number;
}

interface Node {
  mesh?: number;
  children?: number[];
  matrix?: number[];
  translation?: [number, number, number];
  rotation?: [number, number, number, number];
  scale?: [number, number, number];
}

interface Material {
  pbrMetallicRoughness?: { baseColorFactor?: number[]; baseColorTexture?: { index: number; texCoord?: number } };
}

interface Document {
  scene?: number;
  scenes?: { nodes?: number[] }[];
  nodes?: Node[];
  meshes?: { primitives: Primitive[] }[];
  materials?: Material[];
  textures?: { source?: number }[];
  images?: { bufferView?: number; mimeType?: string; uri?: string }[];
  accessors?: Accessor[];
  bufferViews?: { buffer: number; byteOffset?: number; byteLength: number; byteStride?: number }[];
  buffers?: { uri?: string }[];
}

const SIZES: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
const [TRIANGLES, STRIP, FAN] = [4, 5, 6];
/** By component type: size in bytes, reader, and the largest value for normalized integers. */
const COMPONENTS: Record<number, [number, (view: DataView, at: number) => number, number]> = {
  5120: [1, (view, at) => view.getInt8(at), 127],
  5121: [1, (view, at) => view.getUint8(at), 255],
  5122: [2, (view, at) => view.getInt16(at, true), 32767],
  5123: [2, (view, at) => view.getUint16(at, true), 65535],
  5125: [4, (view, at) => view.getUint32(at, true), 4294967295],
  5126: [4, (view, at) => view.getFloat32(at, true), 1],
};

/** Reads the appearance of a glTF 2.0 file, binary or text: base colours, base colour textures and vertex colours. */
export async function readGltf(bytes: Uint8Array, beside: Beside): Promise<Appearance> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const isBinary = view.getUint32(0, true) === 0x46546c67;
  const length = isBinary ? view.getUint32(12, true) : bytes.length;
  const text = isBinary ? bytes.subarray(20, 20 + length) : bytes;
  const document = JSON.parse(new TextDecoder().decode(text)) as Document;
  const chunk = isBinary ? bytes.subarray(20 + length + 8) : null;
  const file = new File(document, await Promise.all((document.buffers ?? []).map(async ({ uri }) => (uri === undefined ? chunk : await fetched(uri, beside)))));
  const images = await Promise.all((document.images ?? []).map((image) => file.image(image, beside)));
  const patches: Patch[] = [];
  const roots = document.scenes?.[document.scene ?? 0]?.nodes ?? (document.nodes ?? []).map((_, i) => i);
  const walk = (number: number, parent: Matrix4, depth: number): void => {
    const node = document.nodes?.[number];
    if (!node || depth > 100) return;
    const matrix = parent.clone().multiply(poseOf(node));
    for (const primitive of document.meshes?.[node.mesh ?? -1]?.primitives ?? []) {
      const patch = file.patch(primitive, matrix, images);
      if (patch) patches.push(patch);
    }
    for (const child of node.children ?? []) walk(child, matrix, depth + 1);
  };
  for (const root of roots) walk(root, new Matrix4(), 0);
  return { patches, up: "y" };
}

function poseOf({ matrix, translation = [0, 0, 0], rotation = [0, 0, 0, 1], scale = [1, 1, 1] }: Node): Matrix4 {
  if (matrix) return new Matrix4().fromArray(matrix);
  return new Matrix4().compose(new Vector3(...translation), new Quaternion(...rotation), new Vector3(...scale));
}

/** The bytes of a URI in a glTF file: embedded data or a sidecar file. Nothing is loaded from the network. */
async function fetched(uri: string, beside: Beside): Promise<Uint8Array | null> {
  const [, data] = /^data:[^,]*;base64,(.*)$/s.exec(uri) ?? [];
  if (data === undefined) return beside(decodeURIComponent(uri));
  return Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
}

class File {
  constructor(
    readonly document: Document,
    readonly buffers: (Uint8Array | null)[],
  ) {}

  view(number: number | undefined): { bytes: Uint8Array; stride: number | undefined } | null {
    const view = number === undefined ? undefined : this.document.bufferViews?.[number];
    const buffer = view && this.buffers[view.buffer];
    if (!view || !buffer) return null;
    const start = view.byteOffset ?? 0;
    return { bytes: buffer.subarray(start, start + view.byteLength), stride: view.byteStride };
  }

  /** All numbers of an accessor; normalized integers are scaled to 0 to 1. */
  numbers(number: number | undefined, wanted: number): { values: Float64Array; size: number } | null {
    const accessor = number === undefined ? undefined : this.document.accessors?.[number];
    const size = accessor && SIZES[accessor.type];
    const view = accessor && this.view(accessor.bufferView);
    const component = accessor && COMPONENTS[accessor.componentType];
    if (!accessor || !size || !view || !component || size < wanted) return null;
    const [bytes, read, most] = component;
    const data = new DataView(view.bytes.buffer, view.bytes.byteOffset, view.bytes.byteLength);
    const stride = view.stride ?? size * bytes;
    const values = new Float64Array(accessor.count * size);
    const share = accessor.normalized ? 1 / most : 1;
    for (let i = 0; i < accessor.count; i += 1) {
      for (let k = 0; k < size; k += 1) values[i * size + k] = read(data, (accessor.byteOffset ?? 0) + i * stride + k * bytes) * share;
    }
    return { values, size };
  }

  async image({ bufferView, mimeType, uri }: { bufferView?: number; mimeType?: string; uri?: string }, beside: Beside): Promise<ImageBitmap | null> {
    const bytes = uri === undefined ? this.view(bufferView)?.bytes : await fetched(uri, beside);
    return bytes ? readImage(bytes, mimeType ?? imageType(uri ?? "")) : null;
  }

  patch({ attributes, indices, material, mode = TRIANGLES }: Primitive, matrix: Matrix4, images: (ImageBitmap | null)[]): Patch | null {
    const points = this.numbers(attributes["POSITION"], 3);
    if (!points || ![TRIANGLES, STRIP, FAN].includes(mode)) return null;
    const { values } = points;
    const positions = new Float32Array(values.length);
    const point = new Vector3();
    for (let i = 0; i < values.length; i += 3) point.set(values[i]!, values[i + 1]!, values[i + 2]!).applyMatrix4(matrix).toArray(positions, i);
    const { baseColorFactor = [1, 1, 1, 1], baseColorTexture } = this.document.materials?.[material ?? -1]?.pbrMetallicRoughness ?? {};
    const source = baseColorTexture && this.document.textures?.[baseColorTexture.index]?.source;
    const image = source === undefined ? null : (images[source] ?? null);
    const uvs = image ? this.numbers(attributes[`TEXCOORD_${baseColorTexture?.texCoord ?? 0}`], 2) : null;
    const tints = this.numbers(attributes["COLOR_0"], 3);
    const order = this.numbers(indices, 1)?.values ?? Float64Array.from({ length: positions.length / 3 }, (_, i) => i);
    return {
      positions,
      indices: triangles(order, mode),
      colours: tints && coloursOf(tints.values, tints.size),
      uvs: uvs && Float32Array.from(uvs.values),
      image: uvs ? image : null,
      colour: material === undefined ? WHITE : (baseColorFactor.slice(0, 3).map(fromLinear) as Colour),
    };
  }
}

function coloursOf(values: Float64Array, size: number): Float32Array {
  const colours = new Float32Array((values.length / size) * 3);
  for (let i = 0; i < colours.length / 3; i += 1) for (let k = 0; k < 3; k += 1) colours[3 * i + k] = fromLinear(values[i * size + k]!);
  return colours;
}

function triangles(order: Float64Array, mode: number): Uint32Array {
  if (mode === TRIANGLES) return Uint32Array.from(order);
  const corners: number[] = [];
  for (let i = 2; i < order.length; i += 1) {
    const [a, b] = mode === FAN ? [0, i - 1] : i % 2 ? [i - 1, i - 2] : [i - 2, i - 1];
    corners.push(order[a]!, order[b]!, order[i]!);
  }
  return Uint32Array.from(corners);
}
