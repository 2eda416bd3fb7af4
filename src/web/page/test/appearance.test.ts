import assert from "node:assert/strict";
import { test } from "node:test";
import { isColoured } from "../src/viewer/appearance/appearance";
import { readObj } from "../src/viewer/appearance/obj";
import { readOff } from "../src/viewer/appearance/off";
import { readPly } from "../src/viewer/appearance/ply";
import { readAppearance } from "../src/viewer/appearance/read";
// @ts-expect-error The browser tests are JavaScript.
import { colouredGlb, colouredObj, colouredOff, colouredPly } from "../../../../tests/browser/support/coloured.mjs";

// A browser reads pictures; here there is none.
globalThis.createImageBitmap = () => Promise.reject(new Error("no pictures here"));

const bytes = (text: string): Uint8Array => new TextEncoder().encode(text);
const nothing = (): Promise<null> => Promise.resolve(null);
const buffer = (file: Uint8Array): ArrayBuffer => new Uint8Array(file).buffer as ArrayBuffer;
const rounded = (numbers: Iterable<number>): number[] => [...numbers].map((x) => Math.round(x * 100) / 100);

test("reads vertex and face colours of PLY files, text and binary", () => {
  const head = "property float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n";
  const face = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  const ascii = readPly(bytes(`ply\nformat ascii 1.0\nelement vertex 3\n${head}${face}0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n`));
  assert.deepEqual([...ascii.patches[0]!.colours!], [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  assert.deepEqual([...ascii.patches[0]!.positions], [0, 0, 0, 1, 0, 0, 0, 1, 0]);
  const body = new DataView(new ArrayBuffer(3 * 15 + 13));
  for (let v = 0; v < 3; v += 1) {
    for (let k = 0; k < 3; k += 1) body.setFloat32(15 * v + 4 * k, v + k, true);
    body.setUint8(15 * v + 12 + v, 255);
  }
  body.setUint8(45, 3);
  for (let k = 0; k < 3; k += 1) body.setInt32(46 + 4 * k, k, true);
  const start = bytes(`ply\nformat binary_little_endian 1.0\nelement vertex 3\n${head}${face}`);
  const binary = readPly(Uint8Array.from([...start, ...new Uint8Array(body.buffer)]));
  assert.deepEqual([...binary.patches[0]!.positions], [0, 1, 2, 1, 2, 3, 2, 3, 4]);
  assert.deepEqual([...binary.patches[0]!.colours!], [1, 0, 0, 0, 1, 0, 0, 0, 1]);
});

test("reads integer and fractional colours of OFF vertices and faces", () => {
  const vertices = readOff(bytes("COFF\n# a comment\n3 1 0\n0 0 0 255 0 0 255\n1 0 0 255 0 0 255\n0 1 0 255 0 0 255\n3 0 1 2\n"));
  assert.deepEqual([...vertices.patches[0]!.colours!].slice(0, 3), [1, 0, 0]);
  const faces = readOff(bytes("OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 0.5 0.25 0\n"));
  assert.deepEqual([...faces.patches[0]!.colours!].slice(0, 3), [0.5, 0.25, 0]);
  assert.ok(!isColoured(readOff(bytes("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"))));
});

test("reads OBJ materials and negative indices, and requests only the named files", async () => {
  const asked: string[] = [];
  const beside = async (name: string): Promise<Uint8Array | null> => {
    asked.push(name);
    return name === "two words.mtl" ? bytes("newmtl red\nKd 1 0 0\nmap_Kd -s 1 1 1 skin.png\n") : null;
  };
  const { patches, up } = await readObj(bytes("mtllib two words.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl red\nf -4 -3 -2 -1\n"), beside);
  assert.deepEqual([patches.length, patches[0]!.positions.length, patches[0]!.colour, up], [1, 18, [1, 0, 0], null]);
  assert.deepEqual(asked, ["two words.mtl", "skin.png"]);
  const tinted = await readObj(bytes("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nf 1 2 3\n"), nothing);
  assert.deepEqual([...tinted.patches[0]!.colours!], [1, 0, 0, 0, 1, 0, 0, 0, 1]);
});

test("recognizes files by content, and archives by the files inside", async () => {
  const glb = await readAppearance(buffer(colouredGlb()));
  assert.equal(glb?.up, "y");
  // Base colours are linear in glTF files.
  assert.deepEqual(rounded(glb!.patches[0]!.colour), [0.91, 0.1, 0.1]);
  assert.deepEqual(rounded(glb!.patches[1]!.positions.slice(0, 3)), [0.03, 0, 0]);
  assert.equal(glb!.patches[1]!.uvs, null, "a picture that can't be read leaves the colour");
  const obj = await readAppearance(buffer(colouredObj()));
  assert.deepEqual(obj?.patches.map(({ colour }) => colour), [[0.9, 0.05, 0.05], [1, 1, 1]]);
  for (const file of [colouredPly(), colouredOff()]) assert.equal((await readAppearance(buffer(file)))?.patches.length, 1);
});

test("a file without colours, or an unreadable file, has no appearance", async () => {
  assert.equal(await readAppearance(buffer(bytes("solid a\nendsolid\n"))), null);
  assert.equal(await readAppearance(buffer(bytes("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"))), null);
  const { warn } = console;
  console.warn = () => undefined;
  assert.equal(await readAppearance(buffer(bytes("PK\x03\x04 broken"))), null);
  assert.equal(await readAppearance(buffer(bytes("ply\nformat ascii 1.0\n"))), null);
  console.warn = warn;
});
