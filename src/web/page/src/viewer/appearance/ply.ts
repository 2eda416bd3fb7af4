import { type Appearance, PatchBuilder } from "./appearance";

interface Property {
  name: string;
  type: string;
  /** For a list: the type of its count. */
  count: string | null;
}

interface Element {
  name: string;
  count: number;
  properties: Property[];
}

type Reader = (type: string) => number;

const BYTES: Record<string, number> = { char: 1, uchar: 1, short: 2, ushort: 2, int: 4, uint: 4, float: 4, double: 8 };
const NAMES: Record<string, string> = { int8: "char", uint8: "uchar", int16: "short", uint16: "ushort", int32: "int", uint32: "uint", float32: "float", float64: "double" };

/** Reads the colours of a PLY file, at its vertices or its faces. */
export function readPly(bytes: Uint8Array): Appearance {
  const start = new TextDecoder("latin1").decode(bytes.subarray(0, 20_000));
  const [head] = /^ply\r?\n[^]*?end_header[^\n]*\n/.exec(start) ?? [];
  if (!head) throw new Error("the PLY file has no header");
  const elements: Element[] = [];
  let format = "ascii";
  for (const line of head.split(/\r?\n/)) {
    const [key, a = "", b = "", c = "", d = ""] = line.trim().split(/\s+/);
    if (key === "format") format = a;
    else if (key === "element") elements.push({ name: a, count: Number(b), properties: [] });
    else if (key === "property") {
      const type = (name: string): string => NAMES[name] ?? name;
      elements.at(-1)?.properties.push(a === "list" ? { name: d, type: type(c), count: type(b) } : { name: b, type: type(a), count: null });
    }
  }
  const body = bytes.subarray(head.length);
  const read = format === "ascii" ? wordReader(body) : byteReader(body, format === "binary_little_endian");
  const points: number[][] = [];
  const tints: (number[] | null)[] = [];
  const [byVertex, byFace, plain] = [new PatchBuilder(), new PatchBuilder(), new PatchBuilder()];
  for (const { name, count, properties } of elements) {
    for (let i = 0; i < count; i += 1) {
      const values: Record<string, number> = {};
      let corners: number[] = [];
      for (const property of properties) {
        if (property.count === null) values[property.name] = read(property.type);
        else {
          const list = Array.from({ length: read(property.count) }, () => read(property.type));
          if (/^vertex_ind/.test(property.name)) corners = list;
        }
      }
      const tint = tintOf(values, properties);
      if (name === "vertex") {
        points.push([values["x"] ?? 0, values["y"] ?? 0, values["z"] ?? 0]);
        tints.push(tint);
      } else if (name === "face") {
        for (let k = 2; k < corners.length; k += 1) {
          for (const v of [corners[0]!, corners[k - 1]!, corners[k]!]) {
            const [point, own] = [points[v], tints[v]];
            if (point) (tint ? byFace : own ? byVertex : plain).add(point, tint ?? own ?? null);
          }
        }
      }
    }
  }
  return { patches: [byFace, byVertex, plain].map((builder) => builder.build()).filter((patch) => patch !== null), up: null };
}

/** The colour among the values, scaled to 0 to 1. */
function tintOf(values: Record<string, number>, properties: Property[]): number[] | null {
  for (const names of [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]]) {
    if (!names.every((name) => name in values)) continue;
    const type = properties.find(({ name }) => name === names[0])!.type;
    const most = type === "float" || type === "double" ? 1 : type === "ushort" ? 65535 : 255;
    return names.map((name) => values[name]! / most);
  }
  return null;
}

function wordReader(bytes: Uint8Array): Reader {
  const words = new TextDecoder().decode(bytes).split(/\s+/);
  let next = words[0] === "" ? 0 : -1;
  return () => Number(words[(next += 1)]);
}

function byteReader(bytes: Uint8Array, isLittle: boolean): Reader {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  return (type) => {
    const here = at;
    at += BYTES[type] ?? 4;
    if (type === "char") return view.getInt8(here);
    if (type === "uchar") return view.getUint8(here);
    if (type === "short") return view.getInt16(here, isLittle);
    if (type === "ushort") return view.getUint16(here, isLittle);
    if (type === "int") return view.getInt32(here, isLittle);
    if (type === "uint") return view.getUint32(here, isLittle);
    return type === "double" ? view.getFloat64(here, isLittle) : view.getFloat32(here, isLittle);
  };
}
