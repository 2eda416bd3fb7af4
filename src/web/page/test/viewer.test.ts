import assert from "node:assert/strict";
import { test } from "node:test";
import { panes } from "../src/viewer/layout";
import { readColouredMesh } from "../src/viewer/glb";
import { placesOf } from "../src/viewer/places";

const both = (): boolean => true;

test("two sides share the canvas without a gap, whatever its shape", () => {
  for (const [mode, width, height] of [["both", 1001, 600], ["both", 400, 701], ["wipe", 900, 500]] as const) {
    const [before, after] = panes(mode, width, height, 0.3, both);
    const area = (box: readonly number[]): number => box[2]! * box[3]!;
    assert.equal(area(before!.scissor) + area(after!.scissor), width * height, mode);
  }
  assert.deepEqual(panes("both", 800, 600, 0.5, (side) => side === "before").map(({ side }) => side), ["before"]);
});

test("connected lines form one place, and the largest comes first", () => {
  const small = [0, 0, 0, 1, 0, 0, 1, 0, 0, 1, 1, 0];
  const large = [10, 0, 0, 20, 0, 0, 20, 0, 0, 20, 8, 0];
  const places = placesOf({ kind: "hole", surface: null, lines: Float32Array.from([...small, ...large]), dots: null });
  assert.deepEqual(places.map(({ at }) => at), [[15, 4, 0], [0.5, 0.5, 0]]);
});

test("faces that share a vertex form one place", () => {
  const positions = Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 5, 5, 5, 6, 5, 5, 5, 6, 5]);
  const indices = Uint32Array.from([0, 1, 2, 1, 3, 2, 4, 5, 6]);
  const places = placesOf({ kind: "added", surface: { positions, indices }, lines: null, dots: null });
  assert.deepEqual(places.map(({ at }) => at), [[0.5, 0.5, 0], [5.5, 5.5, 5]]);
});

test("reads a coloured mesh without copying its arrays", () => {
  const document = {
    scenes: [{ extras: { legend: [{ kind: "hole", count: 1, colour: "#E69F00" }], sound: "#C4C4C4", scale: 2 } }],
    nodes: [{ name: "model", translation: [1, 2, 3] }, { name: "hole", mesh: 0 }],
    meshes: [{ primitives: [{ mode: 4, attributes: { POSITION: 0 }, indices: 1 }, { mode: 1, attributes: { POSITION: 2 } }] }],
    accessors: [{ bufferView: 0, count: 3, componentType: 5126 }, { bufferView: 1, count: 3, componentType: 5125 }, { bufferView: 2, count: 2, componentType: 5126 }],
    bufferViews: [{ byteOffset: 0, byteLength: 36 }, { byteOffset: 36, byteLength: 12 }, { byteOffset: 48, byteLength: 24 }],
  };
  const text = new TextEncoder().encode(JSON.stringify(document));
  const padded = Math.ceil(text.length / 4) * 4;
  const buffer = new ArrayBuffer(20 + padded + 8 + 72);
  new Uint8Array(buffer, 20, padded).fill(32).set(text);
  const head = new DataView(buffer);
  for (const [i, word] of [0x46546c67, 2, buffer.byteLength, padded, 0x4e4f534a].entries()) head.setUint32(4 * i, word, true);
  new Float32Array(buffer, 28 + padded, 9).set([0, 0, 0, 1, 0, 0, 0, 1, 0]);
  new Uint32Array(buffer, 28 + padded + 36, 3).set([0, 1, 2]);
  const mesh = readColouredMesh(buffer);
  assert.deepEqual([mesh.middle, mesh.scale, mesh.faces, mesh.legend[0]?.kind], [[1, -3, 2], 2, 1, "hole"]);
  assert.equal(mesh.groups[0]?.surface?.positions.buffer, buffer);
  assert.deepEqual([...mesh.groups[0]!.surface!.indices], [0, 1, 2]);
  assert.equal(mesh.groups[0]?.lines?.length, 6);
  assert.throws(() => readColouredMesh(new ArrayBuffer(64)), /not a GLB/);
});
