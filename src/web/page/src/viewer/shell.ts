import { BufferAttribute, BufferGeometry, Mesh, type Object3D } from "three";
import type { ColouredMesh } from "./glb";
import { type Shared, shellMaterial } from "./materials";

/** Models with more faces have no preview, because finding their open parts would block the page. */
export const MOST_FACES = 400_000;

/** The open parts of a mesh: their vertices with normals, their faces, and the edges that only one face has. */
export interface Sheet {
  points: Float64Array;
  normals: Float64Array;
  faces: Uint32Array;
  rim: [number, number][];
}

/** Finds the connected parts of a mesh with open edges. Vertices at the same position count as one. */
export function openParts({ groups }: ColouredMesh): Sheet {
  const ids = new Map<string, number>();
  const points: number[] = [];
  const faces: number[] = [];
  for (const { surface } of groups) {
    if (!surface) continue;
    const { positions, indices } = surface;
    const own = new Map<number, number>();
    const idOf = (v: number): number => {
      const known = own.get(v);
      if (known !== undefined) return known;
      const [x, y, z] = [positions[3 * v]!, positions[3 * v + 1]!, positions[3 * v + 2]!];
      const key = `${x},${y},${z}`;
      let id = ids.get(key);
      if (id === undefined) {
        ids.set(key, (id = ids.size));
        points.push(x, y, z);
      }
      own.set(v, id);
      return id;
    };
    for (let i = 0; i < indices.length; i += 3) {
      const [a, b, c] = [idOf(indices[i]!), idOf(indices[i + 1]!), idOf(indices[i + 2]!)];
      if (a !== b && b !== c && a !== c) faces.push(a, b, c);
    }
  }
  return sheetOf(Float64Array.from(points), faces);
}

function sheetOf(points: Float64Array, all: number[]): Sheet {
  const count = points.length / 3;
  // Maps each edge to its faces.
  const edges = new Map<number, number[]>();
  const key = (a: number, b: number): number => (a < b ? a * count + b : b * count + a);
  for (let f = 0; f < all.length; f += 3) {
    for (let k = 0; k < 3; k += 1) {
      const name = key(all[f + k]!, all[f + ((k + 1) % 3)]!);
      const list = edges.get(name);
      if (list) list.push(f);
      else edges.set(name, [f]);
    }
  }
  // Orients neighbouring faces consistently, part by part, and skips parts without open edges.
  const seen = new Uint8Array(all.length / 3);
  const faces: number[] = [];
  const rim: [number, number][] = [];
  for (let first = 0; first < all.length; first += 3) {
    if (seen[first / 3]) continue;
    seen[first / 3] = 1;
    const part = [first];
    const own: [number, number][] = [];
    for (const f of part) {
      for (let k = 0; k < 3; k += 1) {
        const [a, b] = [all[f + k]!, all[f + ((k + 1) % 3)]!];
        const others = edges.get(key(a, b))!.filter((other) => other !== f);
        if (others.length === 0) own.push([a, b]);
        for (const other of others) {
          if (seen[other / 3]) continue;
          seen[other / 3] = 1;
          const at = [0, 1, 2].find((j) => all[other + j] === a && all[other + ((j + 1) % 3)] === b);
          if (at !== undefined) [all[other + 1], all[other + 2]] = [all[other + 2]!, all[other + 1]!];
          part.push(other);
        }
      }
    }
    if (own.length === 0) continue;
    rim.push(...own);
    for (const f of part) faces.push(all[f]!, all[f + 1]!, all[f + 2]!);
  }
  return { points, normals: normalsOf(points, faces), faces: Uint32Array.from(faces), rim };
}

/** The area-weighted unit normal of each vertex. */
function normalsOf(points: Float64Array, faces: number[]): Float64Array {
  const normals = new Float64Array(points.length);
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f]!, 3 * faces[f + 1]!, 3 * faces[f + 2]!];
    const u = [0, 1, 2].map((k) => points[b + k]! - points[a + k]!);
    const v = [0, 1, 2].map((k) => points[c + k]! - points[a + k]!);
    for (let k = 0; k < 3; k += 1) {
      const [i, j] = [(k + 1) % 3, (k + 2) % 3];
      const part = u[i]! * v[j]! - u[j]! * v[i]!;
      for (const at of [a, b, c]) normals[at + k]! += part;
    }
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i]!, normals[i + 1]!, normals[i + 2]!) || 1;
    for (let k = 0; k < 3; k += 1) normals[i + k]! /= length;
  }
  return normals;
}

/** The triangle corners of a thickened sheet: a copy on each side, and a strip along the boundary. */
export function shellOf({ points, normals, faces, rim }: Sheet, thickness: number): { positions: Float32Array; indices: Uint32Array } {
  const count = points.length / 3;
  const positions = new Float32Array(6 * count);
  for (let i = 0; i < points.length; i += 1) {
    positions[i] = points[i]! + (normals[i]! * thickness) / 2;
    positions[3 * count + i] = points[i]! - (normals[i]! * thickness) / 2;
  }
  const indices: number[] = [];
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [faces[f]!, faces[f + 1]!, faces[f + 2]!];
    indices.push(a, b, c, a + count, c + count, b + count);
  }
  for (const [a, b] of rim) indices.push(b, a, a + count, b, a + count, b + count);
  return { positions, indices: Uint32Array.from(indices) };
}

/** The scene object of the thickened sheet, in the mesh's coordinates. */
export function drawnShell(sheet: Sheet, thickness: number, colour: string, common: Shared): Object3D {
  const { positions, indices } = shellOf(sheet, thickness);
  const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setIndex(new BufferAttribute(indices, 1));
  const mesh = new Mesh(geometry, shellMaterial(colour, common));
  mesh.frustumCulled = false;
  mesh.renderOrder = 5;
  return mesh;
}
