// Models as bytes of STL and OBJ files.

function stl(triangles) {
  const bytes = Buffer.alloc(84 + 50 * triangles.length);
  bytes.writeUInt32LE(triangles.length, 80);
  triangles.forEach((triangle, i) => triangle.flat().forEach((value, k) => bytes.writeFloatLE(value, 96 + 50 * i + 4 * k)));
  return bytes;
}

function ring(around, across, isHole, isFlipped) {
  const at = (i, j) => {
    const [u, v] = [((i % around) / around) * 2 * Math.PI, ((j % across) / across) * 2 * Math.PI];
    const out = 30 + 10 * Math.cos(v);
    return [out * Math.cos(u), out * Math.sin(u), 10 * Math.sin(v)];
  };
  const triangles = [];
  for (let i = 0; i < around; i += 1) {
    for (let j = 0; j < across; j += 1) {
      if (isHole(i, j)) continue;
      const [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
      triangles.push(...(isFlipped(i, j) ? [[a, c, b], [a, d, c]] : [[a, b, c], [a, c, d]]));
    }
  }
  return triangles;
}

/** A box by its lowest corner and its sides. */
function box([x, y, z], [a, b, c]) {
  const corner = (i) => [x + (i & 1 ? a : 0), y + (i & 2 ? b : 0), z + (i & 4 ? c : 0)];
  const faces = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]];
  return faces.map((face) => face.map(corner));
}

/** A ring with two holes and a flipped patch, through which a block runs. */
export function brokenRing() {
  const isHole = (i, j) => (i > 77 && i < 83 && j > 6 && j < 12) || (i > 60 && i < 64 && j > 2 && j < 7);
  const isFlipped = (i, j) => i > 68 && i < 73 && j > 5 && j < 10;
  return stl([...ring(96, 40, isHole, isFlipped), ...box([24, -8, -13], [14, 16, 26])]);
}

/** A ring with a hole, of about this many faces. */
export function largeRing(faces) {
  const around = Math.round(Math.sqrt(faces));
  return stl(ring(around, Math.round(around / 2), (i, j) => i > 20 && i < 40 && j > 10 && j < 30, () => false));
}

/** A box of 40 by 30 by 20 mm without defects. */
export function soundBox() {
  return stl(box([0, 0, 0], [40, 30, 20]));
}

/** A box of 40 by 30 by 20 mm with a sealed cavity of 20 by 10 by 10 mm: whether it is meant to be hollow is open. */
export function hollowBox() {
  return stl([...box([0, 0, 0], [40, 30, 20]), ...box([10, 10, 5], [20, 10, 10]).map(([a, b, c]) => [a, c, b])]);
}

/** A plate of 3 by 2 by 1/8 inches, in inches. */
export function inchPlate() {
  return stl(box([0, 0, 0], [3, 2, 0.125]));
}

/** That box without half of its lid, which is a large hole. */
export function openBox() {
  return stl(box([0, 0, 0], [40, 30, 20]).filter((_, i) => i !== 2));
}

/** An OBJ file of that box with a vertex so near an edge of the lid that one face has almost no area; it is still printable. */
export function flatFace() {
  const points = [[0, 0, 0], [40, 0, 0], [40, 30, 0], [0, 30, 0], [0, 0, 20], [40, 0, 20], [40, 30, 20], [0, 30, 20], [20, 1e-6, 20]];
  const sides = [[1, 3, 2], [1, 4, 3], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 4, 8], [3, 8, 7], [4, 1, 5], [4, 5, 8]];
  const lid = [[5, 6, 9], [6, 7, 9], [7, 8, 9], [8, 5, 9]];
  return Buffer.from([...points.map((point) => `v ${point.join(" ")}`), ...[...sides, ...lid].map((face) => `f ${face.join(" ")}`), ""].join("\n"));
}

/** A glTF file of two objects side by side: a box, and one whose smallest side, a lid, is missing. */
export function twoObjects() {
  const whole = box([0, 0, 0], [0.08, 0.03, 0.04]);
  const meshes = [
    { name: "whole", triangles: whole },
    { name: "no lid", triangles: whole.slice(0, 10) },
  ].map((object) => ({ ...object, points: new Float32Array(object.triangles.flat(2)) }));
  const bytes = Buffer.concat(meshes.map(({ points }) => Buffer.from(points.buffer)));
  const document = {
    asset: { version: "2.0" },
    buffers: [{ byteLength: bytes.length, uri: `data:application/octet-stream;base64,${bytes.toString("base64")}` }],
    bufferViews: meshes.map(({ points }, i) => ({ buffer: 0, byteOffset: i * meshes[0].points.byteLength, byteLength: points.byteLength })),
    accessors: meshes.map(({ points }, i) => ({ bufferView: i, componentType: 5126, count: points.length / 3, type: "VEC3" })),
    meshes: meshes.map(({ name }, i) => ({ name, primitives: [{ attributes: { POSITION: i } }] })),
    nodes: meshes.map((_, i) => ({ mesh: i, translation: [0.1 * i, 0, 0] })),
    scenes: [{ nodes: [0, 1] }],
    scene: 0,
  };
  return Buffer.from(JSON.stringify(document));
}

/** A plate with a separate wall of 0.5 mm on it. */
export function thinWall() {
  return stl([...box([0, 0, 0], [40, 30, 3]), ...box([5, 5, 2], [0.5, 20, 25])]);
}

/** A plate of 6 by 6 by 0.2 mm: a valid solid that is too thin and too small for most processes. */
export function plate() {
  return stl(box([0, 0, 0], [6, 6, 0.2]));
}

/** An open sheet, which repair makes solid only on request. */
export function sheet() {
  const n = 20;
  const lines = [];
  for (let i = 0; i <= n; i += 1) for (let j = 0; j <= n; j += 1) lines.push(`v ${i} ${j} ${2 * Math.sin(i / 4) * Math.cos(j / 5)}`);
  const at = (i, j) => i * (n + 1) + j + 1;
  for (let i = 0; i < n; i += 1) for (let j = 0; j < n; j += 1) lines.push(`f ${at(i, j)} ${at(i + 1, j)} ${at(i + 1, j + 1)} ${at(i, j + 1)}`);
  return Buffer.from(lines.join("\n"));
}
