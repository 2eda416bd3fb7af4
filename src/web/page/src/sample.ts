type Point = [number, number, number];
type Triangle = [Point, Point, Point];

/** A sample to try the page with: a ring with holes and flipped faces, intersected by a block. Binary STL in millimetres. */
export function brokenSample(): File {
  const triangles = [...ring(96, 40), ...block([24, -8, -13], [14, 16, 26])];
  return new File([binaryStl(triangles)], "broken-sample.stl", { type: "model/stl" });
}

function ring(around: number, across: number): Triangle[] {
  const at = (i: number, j: number): Point => {
    const u = ((i % around) / around) * 2 * Math.PI;
    const v = ((j % across) / across) * 2 * Math.PI;
    const thick = 10 * (1 + 0.08 * Math.sin(6 * u) * Math.cos(3 * v));
    const out = 30 + thick * Math.cos(v);
    return [out * Math.cos(u), out * Math.sin(u), thick * Math.sin(v)];
  };
  const triangles: Triangle[] = [];
  for (let i = 0; i < around; i += 1) {
    for (let j = 0; j < across; j += 1) {
      if (isHole(i, j)) continue;
      const [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
      const isFlipped = i > 66 && i < 72 && j > 6 && j < 12;
      triangles.push(isFlipped ? [a, c, b] : [a, b, c], isFlipped ? [a, d, c] : [a, c, d]);
    }
  }
  return triangles;
}

function isHole(i: number, j: number): boolean {
  return (i > 76 && i < 82 && j > 6 && j < 12) || (i > 52 && i < 55 && j > 3 && j < 8) || (i === 88 && j === 4);
}

function block([x, y, z]: Point, [a, b, c]: Point): Triangle[] {
  const corner = (i: number): Point => [x + (i & 1 ? a : 0), y + (i & 2 ? b : 0), z + (i & 4 ? c : 0)];
  const faces = [0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5];
  return Array.from({ length: 12 }, (_, f) => [0, 1, 2].map((k) => corner(faces[3 * f + k]!)) as Triangle);
}

function binaryStl(triangles: Triangle[]): ArrayBuffer {
  const bytes = new DataView(new ArrayBuffer(84 + 50 * triangles.length));
  bytes.setUint32(80, triangles.length, true);
  for (const [i, triangle] of triangles.entries()) {
    for (const [k, value] of triangle.flat().entries()) bytes.setFloat32(96 + 50 * i + 4 * k, value, true);
  }
  return bytes.buffer as ArrayBuffer;
}
