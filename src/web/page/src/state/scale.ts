/** Formats that the page can scale: they store plain coordinates, or allow a scale. */
const SCALABLE = ["stl", "obj", "glb"];

export function isScalable(format: string): boolean {
  return SCALABLE.includes(format);
}

/** A copy of a model file with all lengths multiplied by a factor. Throws if the file has another format. */
export async function scaledCopy(file: File, format: string, factor: number): Promise<File> {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const scaled = format === "glb" ? scaledGltf(bytes, factor) : format === "stl" && isBinaryStl(bytes) ? scaledStl(bytes, factor) : scaledText(bytes, factor);
  return new File([scaled], file.name, { type: file.type });
}

function isBinaryStl(bytes: Uint8Array): boolean {
  return bytes.length >= 84 && 84 + 50 * new DataView(bytes.buffer).getUint32(80, true) === bytes.length;
}

/** Binary STL: three vertices after the normal of each face. */
function scaledStl(bytes: Uint8Array, factor: number): ArrayBuffer {
  const copy = bytes.slice();
  const view = new DataView(copy.buffer);
  for (let at = 96; at + 38 <= copy.length; at += 50) {
    for (let k = 0; k < 9; k += 1) view.setFloat32(at + 4 * k, view.getFloat32(at + 4 * k, true) * factor, true);
  }
  return copy.buffer;
}

/** ASCII STL and OBJ: the three numbers after `vertex` or `v`. */
function scaledText(bytes: Uint8Array, factor: number): string {
  const line = /^(\s*(?:vertex|v)\s+)(\S+)(\s+)(\S+)(\s+)(\S+)/gim;
  const times = (text: string): string => String(Number(text) * factor);
  return new TextDecoder().decode(bytes).replace(line, (_, head: string, x: string, a: string, y: string, b: string, z: string) => `${head}${times(x)}${a}${times(y)}${b}${times(z)}`);
}

interface Gltf {
  scenes?: { nodes?: number[] }[];
  nodes?: object[];
}

/** glTF: every scene gets one parent node that scales its nodes. */
function scaledGltf(bytes: Uint8Array, factor: number): Blob | string {
  const view = new DataView(bytes.buffer);
  const isBinary = view.getUint32(0, true) === 0x46546c67;
  const length = isBinary ? view.getUint32(12, true) : bytes.length;
  const document = JSON.parse(new TextDecoder().decode(isBinary ? bytes.subarray(20, 20 + length) : bytes)) as Gltf;
  const nodes = (document.nodes ??= []);
  for (const scene of document.scenes ?? []) {
    nodes.push({ name: "scale", scale: [factor, factor, factor], children: scene.nodes ?? [] });
    scene.nodes = [nodes.length - 1];
  }
  const text = JSON.stringify(document);
  if (!isBinary) return text;
  const json = new TextEncoder().encode(text);
  const padded = new Uint8Array(Math.ceil(json.length / 4) * 4).fill(32);
  padded.set(json);
  const rest = bytes.slice(20 + length);
  const head = new DataView(new ArrayBuffer(20));
  [0x46546c67, 2, 20 + padded.length + rest.length, padded.length, 0x4e4f534a].forEach((word, i) => head.setUint32(4 * i, word, true));
  return new Blob([head.buffer, padded, rest]);
}
