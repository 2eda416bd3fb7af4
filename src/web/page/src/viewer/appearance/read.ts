import { type Appearance, type Beside, isColoured } from "./appearance";
import { readGltf } from "./gltf";
import { readObj } from "./obj";
import { readOff } from "./off";
import { readPly } from "./ply";
import { read3mf } from "./threemf";
import { ZipArchive } from "./zip";

/** Larger files are shown without their colours, because parsing them takes many times their size in memory. */
export const MOST_BYTES = 80_000_000;
const NOTHING: Beside = () => Promise.resolve(null);

/** Reads the colours and textures of a model file; null if there are none or they are unreadable. */
export async function readAppearance(buffer: ArrayBuffer): Promise<Appearance | null> {
  if (buffer.byteLength > MOST_BYTES) return null;
  try {
    const appearance = await readFile(new Uint8Array(buffer), NOTHING);
    return appearance && isColoured(appearance) ? appearance : null;
  } catch (error) {
    console.warn("The colours of the model could not be read:", error);
    return null;
  }
}

async function readFile(bytes: Uint8Array, beside: Beside): Promise<Appearance | null> {
  const start = new TextDecoder("latin1").decode(bytes.subarray(0, 2000));
  if (start.startsWith("PK")) return beside === NOTHING ? readArchive(new ZipArchive(bytes)) : null;
  if (start.startsWith("glTF") || /^\s*\{[^]*"asset"/.test(start)) return readGltf(bytes, beside);
  if (/^ply\s/.test(start)) return readPly(bytes);
  if (/^\s*(#.*\n\s*)*(ST)?C?N?OFF\s/.test(start) && !/^\s*(#.*\n\s*)*\S*OFF\s+BINARY/.test(start)) return readOff(bytes);
  return /^(mtllib|v|o|g|usemtl)\s/m.test(start) ? readObj(bytes, beside) : null;
}

/** Reads an archive: the 3MF model, or else the first model file with its sidecar files. */
async function readArchive(archive: ZipArchive): Promise<Appearance | null> {
  const { names } = archive;
  if (names.some((name) => name.endsWith(".model"))) return read3mf(archive);
  const model = names.find((name) => /\.(obj|gltf|glb|ply|off)$/i.test(name) && !/(^|\/)(__MACOSX|\.)/.test(name));
  const bytes = model === undefined ? null : await archive.read(model);
  return bytes && readFile(bytes, (name) => archive.read(name));
}
