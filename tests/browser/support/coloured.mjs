// Models with colours and textures: a red box beside one with a blue and yellow checker pattern. They are 60 mm tall along
// the format's up axis, and 20 mm along the others.
import { deflateSync } from "node:zlib";

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k += 1) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

function crc32(bytes) {
  let sum = 0xffffffff;
  for (const byte of bytes) sum = CRC[(sum ^ byte) & 255] ^ (sum >>> 8);
  return (sum ^ 0xffffffff) >>> 0;
}

/** A ZIP archive that stores its files as they are. */
export function zip(files) {
  const [parts, index] = [[], []];
  let at = 0;
  for (const [name, content] of files) {
    const [path, bytes] = [Buffer.from(name), Buffer.from(content)];
    const head = Buffer.alloc(26);
    head.writeUInt16LE(20, 0);
    head.writeUInt32LE(crc32(bytes), 10);
    head.writeUInt32LE(bytes.length, 14);
    head.writeUInt32LE(bytes.length, 18);
    head.writeUInt16LE(path.length, 22);
    const entry = Buffer.alloc(16);
    entry.writeUInt32LE(at, 12);
    parts.push(Buffer.from("PK\x03\x04"), head, path, bytes);
    index.push(Buffer.from("PK\x01\x02\x14\x00"), head, entry.subarray(2), path);
    at += 30 + path.length + bytes.length;
  }
  const listed = Buffer.concat(index);
  const end = Buffer.alloc(22);
  end.write("PK\x05\x06", "latin1");
  end.writeUInt16LE(files.length, 8);
  end.writeUInt16LE(files.length, 10);
  end.writeUInt32LE(listed.length, 12);
  end.writeUInt32LE(at, 16);
  return Buffer.concat([...parts, listed, end]);
}

/** A PNG picture of 8 by 8 squares, each blue or yellow. */
export function checkers() {
  const rows = Buffer.concat(
    Array.from({ length: 64 }, (_, y) => {
      const row = Buffer.alloc(1 + 64 * 3);
      for (let x = 0; x < 64; x += 1) row.set(((x >> 3) + (y >> 3)) % 2 ? [20, 60, 230] : [250, 220, 30], 1 + 3 * x);
      return row;
    }),
  );
  const chunk = (name, data) => {
    const body = Buffer.concat([Buffer.from(name), data]);
    const [length, sum] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(data.length);
    sum.writeUInt32BE(crc32(body));
    return Buffer.concat([length, body, sum]);
  };
  const head = Buffer.from([0, 0, 0, 64, 0, 0, 0, 64, 8, 2, 0, 0, 0]);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk("IHDR", head), chunk("IDAT", deflateSync(rows)), chunk("IEND", Buffer.alloc(0))]);
}

const QUADS = [
  [0, 2, 3, 1],
  [4, 5, 7, 6],
  [0, 1, 5, 4],
  [2, 6, 7, 3],
  [0, 4, 6, 2],
  [1, 3, 7, 5],
];
const CORNERS = [[0, 0], [0, 1], [1, 1], [1, 0]];

/** The eight corners of a box from x on, with the tall side along an axis; in millimetres. */
function corners(x, tall) {
  const sides = [20, 20, 20];
  sides[tall] = 60;
  return Array.from({ length: 8 }, (_, i) => [x + (i & 1 ? sides[0] : 0), i & 2 ? sides[1] : 0, i & 4 ? sides[2] : 0]);
}

const triangles = ([a, b, c, d]) => [[a, b, c], [a, c, d]];

/** A GLB file, in metres and with y up: one material with a colour, one with a texture. */
export function colouredGlb() {
  const [red, checkered] = [corners(0, 1), corners(30, 1)].map((points) => points.map((point) => point.map((x) => x / 1000)));
  const [chunks, views, accessors] = [[], [], []];
  let length = 0;
  const view = (bytes) => {
    const padded = Buffer.concat([bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4)]);
    views.push({ buffer: 0, byteOffset: length, byteLength: bytes.length });
    chunks.push(padded);
    length += padded.length;
    return views.length - 1;
  };
  const accessor = (array, componentType, type, size) => {
    const bounds = type === "VEC3" ? { min: [0, 1, 2].map((k) => Math.min(...array.filter((_, i) => i % 3 === k))), max: [0, 1, 2].map((k) => Math.max(...array.filter((_, i) => i % 3 === k))) } : {};
    accessors.push({ bufferView: view(Buffer.from(array.buffer)), componentType, type, count: array.length / size, ...bounds });
    return accessors.length - 1;
  };
  const flat = (points, quads) => Float32Array.from(quads.flatMap((quad) => quad.flatMap((i) => points[i])));
  const order = Uint16Array.from(QUADS.flatMap((_, q) => triangles([0, 1, 2, 3].map((k) => 4 * q + k)).flat()));
  const uv = Float32Array.from(QUADS.flatMap(() => CORNERS.flat()));
  const indices = accessor(order, 5123, "SCALAR", 1);
  const primitives = [
    { attributes: { POSITION: accessor(flat(red, QUADS), 5126, "VEC3", 3) }, indices, material: 0 },
    { attributes: { POSITION: accessor(flat(checkered, QUADS), 5126, "VEC3", 3), TEXCOORD_0: accessor(uv, 5126, "VEC2", 2) }, indices, material: 1 },
  ];
  const document = {
    asset: { version: "2.0" },
    images: [{ bufferView: view(checkers()), mimeType: "image/png" }],
    textures: [{ source: 0 }],
    materials: [{ pbrMetallicRoughness: { baseColorFactor: [0.8, 0.01, 0.01, 1] } }, { pbrMetallicRoughness: { baseColorTexture: { index: 0 } } }],
    meshes: primitives.map((primitive) => ({ primitives: [primitive] })),
    nodes: [{ mesh: 0 }, { mesh: 1 }],
    scenes: [{ nodes: [0, 1] }],
    scene: 0,
    accessors,
    bufferViews: views,
    buffers: [{ byteLength: length }],
  };
  const text = Buffer.from(JSON.stringify(document));
  const json = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, " ")]);
  const head = (size, kind) => {
    const bytes = Buffer.alloc(8);
    bytes.writeUInt32LE(size, 0);
    bytes.writeUInt32LE(kind, 4);
    return bytes;
  };
  const first = Buffer.alloc(12);
  first.write("glTF");
  first.writeUInt32LE(2, 4);
  first.writeUInt32LE(28 + json.length + length, 8);
  return Buffer.concat([first, head(json.length, 0x4e4f534a), json, head(length, 0x004e4942), ...chunks]);
}

/** A ZIP archive of an OBJ file, its materials and its texture; z is up. */
export function colouredObj() {
  const lines = ["mtllib colours.mtl"];
  for (const point of [...corners(0, 2), ...corners(30, 2)]) lines.push(`v ${point.join(" ")}`);
  for (const corner of CORNERS) lines.push(`vt ${corner.join(" ")}`);
  lines.push("usemtl red", ...QUADS.map((quad) => `f ${quad.map((i) => i + 1).join(" ")}`));
  lines.push("usemtl checkered", ...QUADS.map((quad) => `f ${quad.map((i, k) => `${i + 9}/${k + 1}`).join(" ")}`));
  const materials = "newmtl red\nKd 0.9 0.05 0.05\nnewmtl checkered\nKd 1 1 1\nmap_Kd checkers.png\n";
  return zip([["colours.obj", lines.join("\n")], ["colours.mtl", materials], ["checkers.png", checkers()]]);
}

/** A PLY file with colours at its vertices: one box red, one blue. */
export function colouredPly() {
  const points = [...corners(0, 2), ...corners(30, 2)];
  const faces = [...QUADS, ...QUADS.map((quad) => quad.map((i) => i + 8))];
  const properties = ["x", "y", "z"].map((name) => `property float ${name}`).concat(["red", "green", "blue"].map((name) => `property uchar ${name}`));
  const head = ["ply", "format ascii 1.0", `element vertex ${points.length}`, ...properties, `element face ${faces.length}`, "property list uchar int vertex_indices", "end_header"];
  const body = [...points.map((point, i) => [...point, ...(i < 8 ? [230, 20, 20] : [20, 60, 230])].join(" ")), ...faces.map((face) => [4, ...face].join(" "))];
  return Buffer.from([...head, ...body, ""].join("\n"));
}

/** An OFF file with colours at its faces: one box red, one blue. */
export function colouredOff() {
  const points = [...corners(0, 2), ...corners(30, 2)];
  const faces = [...QUADS.map((quad) => [4, ...quad, 230, 20, 20]), ...QUADS.map((quad) => [4, ...quad.map((i) => i + 8), 20, 60, 230])];
  return Buffer.from(["OFF", `${points.length} ${faces.length} 0`, ...[...points, ...faces].map((line) => line.join(" ")), ""].join("\n"));
}

/** A 3MF file of two objects with base materials: one red, one blue. */
export function coloured3mf() {
  const object = (id, x, material) => {
    const vertices = corners(x, 2).map(([x, y, z]) => `<vertex x="${x}" y="${y}" z="${z}"/>`);
    const faces = QUADS.flatMap(triangles).map(([a, b, c]) => `<triangle v1="${a}" v2="${b}" v3="${c}"/>`);
    return `<object id="${id}" type="model" pid="1" pindex="${material}"><mesh><vertices>${vertices.join("")}</vertices><triangles>${faces.join("")}</triangles></mesh></object>`;
  };
  const model = `<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>
<basematerials id="1"><base name="red" displaycolor="#E61414"/><base name="blue" displaycolor="#143CE6FF"/></basematerials>
${object(2, 0, 0)}${object(3, 0, 1)}</resources><build><item objectid="2"/><item objectid="3" transform="1 0 0 0 1 0 0 0 1 30 0 0"/></build></model>`;
  const types = `<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>`;
  const relations = `<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>`;
  return zip([["[Content_Types].xml", types], ["_rels/.rels", relations], ["3D/3dmodel.model", model]]);
}
