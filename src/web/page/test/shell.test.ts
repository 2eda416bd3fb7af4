import assert from "node:assert/strict";
import { test } from "node:test";
import { distance } from "../src/viewer/distance";
import type { ColouredMesh } from "../src/viewer/glb";
import { frameOf, fromWorld, toWorld } from "../src/viewer/model";
import { openParts, shellOf } from "../src/viewer/shell";

function mesh(positions: number[], indices: number[]): ColouredMesh {
  const surface = { positions: Float32Array.from(positions), indices: Uint32Array.from(indices) };
  return { groups: [{ kind: "sound", surface, lines: null, dots: null }], legend: [], sound: "#C4C4C4", middle: [0, 0, 0], scale: 1, faces: indices.length / 3 };
}

const square = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0];
const tetrahedron = [5, 0, 0, 6, 0, 0, 5, 1, 0, 5, 0, 1];

test("thickening closes open parts and ignores closed parts", () => {
  // The second face of the square is turned the wrong way.
  const it = mesh([...square, ...tetrahedron], [0, 1, 2, 0, 3, 2, 4, 6, 5, 4, 5, 7, 5, 6, 7, 6, 4, 7]);
  const sheet = openParts(it);
  assert.deepEqual([sheet.faces.length / 3, sheet.rim.length], [2, 4]);
  const { positions, indices } = shellOf(sheet, 0.5);
  const used = new Set([...indices].map((v) => Math.round(positions[3 * v + 2]! * 1000)));
  assert.deepEqual([...used].sort((a, b) => a - b), [-250, 250]);
  // Each edge of a closed solid is crossed once in each direction.
  const edges = new Map<string, number>();
  for (let i = 0; i < indices.length; i += 3) {
    for (let k = 0; k < 3; k += 1) {
      const [a, b] = [indices[i + k]!, indices[i + ((k + 1) % 3)]!];
      edges.set(`${Math.min(a, b)} ${Math.max(a, b)}`, (edges.get(`${Math.min(a, b)} ${Math.max(a, b)}`) ?? 0) + (a < b ? 1 : -1));
    }
  }
  assert.ok([...edges.values()].every((sum) => sum === 0));
  assert.equal(openParts(mesh(tetrahedron, [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3])).faces.length, 0);
});

test("a y-up model is rotated to z up, and points survive the round trip", () => {
  const frame = frameOf(mesh([0, 0, 0, 2, 0, 0, 0, 6, 0, 0, 0, 4], [0, 1, 2, 0, 1, 3]), "y");
  const top = toWorld(frame, [1, 6, 2]);
  assert.ok(Math.abs(top[2] - 3 / frame.radius) < 1e-9 && Math.abs(top[0]) < 1e-9 && Math.abs(top[1]) < 1e-9, `${top}`);
  for (const up of ["y", "z"] as const) {
    const point: [number, number, number] = [0.5, 1.25, -3];
    const back = fromWorld({ ...frame, up }, toWorld({ ...frame, up }, point));
    assert.ok(back.every((x, k) => Math.abs(x - point[k]!) < 1e-9), `${up}: ${back}`);
  }
});

test("a distance has a component per axis, without rounding errors", () => {
  assert.deepEqual(distance([0, 0, 0], [3, -4, 1e-7]), { length: 5.000000000000001, along: [3, 4, 0] });
});
