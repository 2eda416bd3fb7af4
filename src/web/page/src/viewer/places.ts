import type { Group } from "./glb";

/** A place to move the camera to: a bounding sphere, in the scene's coordinates. */
export interface Place {
  at: [number, number, number];
  radius: number;
}

/** Most places per group. */
const MOST = 5000;

/** The places of a group: connected lines, then dots, then connected faces; largest first. */
export function placesOf(group: Group): Place[] {
  if (group.lines) return gathered(group.lines, byPosition(group.lines), pairs(group.lines.length / 3));
  if (group.dots) {
    const dots = group.dots;
    const count = Math.min(dots.length / 3, MOST);
    return Array.from({ length: count }, (_, i) => ({ at: [dots[3 * i]!, dots[3 * i + 1]!, dots[3 * i + 2]!], radius: 0 }));
  }
  if (!group.surface) return [];
  const { positions, indices } = group.surface;
  const number = Uint32Array.from({ length: positions.length / 3 }, (_, i) => i);
  return gathered(positions, number, indices);
}

function pairs(points: number): Uint32Array {
  // Each line segment as a degenerate face, with its second end repeated.
  const faces = new Uint32Array((points / 2) * 3);
  for (let i = 0; i < points / 2; i += 1) faces.set([2 * i, 2 * i + 1, 2 * i + 1], 3 * i);
  return faces;
}

/** For each point, the index of the first point at the same position. */
function byPosition(positions: Float32Array): Uint32Array {
  const first = new Map<string, number>();
  return Uint32Array.from({ length: positions.length / 3 }, (_, i) => {
    const key = `${positions[3 * i]},${positions[3 * i + 1]},${positions[3 * i + 2]}`;
    const known = first.get(key);
    if (known === undefined) first.set(key, i);
    return known ?? i;
  });
}

/** A bounding sphere for each set of connected faces. */
function gathered(positions: Float32Array, number: Uint32Array, faces: Uint32Array): Place[] {
  const parent = number.slice();
  const root = (v: number): number => {
    while (parent[v] !== v) {
      parent[v] = parent[parent[v]!]!;
      v = parent[v]!;
    }
    return v;
  };
  for (let i = 0; i < faces.length; i += 3) {
    const a = root(faces[i]!);
    for (const other of [faces[i + 1]!, faces[i + 2]!]) {
      const b = root(other);
      if (a !== b) parent[b] = a;
    }
  }
  const boxes = new Map<number, number[]>();
  for (const v of faces) {
    const key = root(v);
    let box = boxes.get(key);
    if (!box) boxes.set(key, (box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity]));
    for (let k = 0; k < 3; k += 1) {
      const x = positions[3 * v + k]!;
      if (x < box[k]!) box[k] = x;
      if (x > box[3 + k]!) box[3 + k] = x;
    }
  }
  const places = [...boxes.values()].map(([x0, y0, z0, x1, y1, z1]): Place => ({
    at: [(x0! + x1!) / 2, (y0! + y1!) / 2, (z0! + z1!) / 2],
    radius: Math.hypot(x1! - x0!, y1! - y0!, z1! - z0!) / 2,
  }));
  return places.sort((a, b) => b.radius - a.radius).slice(0, MOST);
}
