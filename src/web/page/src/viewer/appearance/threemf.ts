import { Matrix4, Vector3 } from "three";
import { type Appearance, type Colour, PatchBuilder, type Patch, WHITE, imageType, readImage } from "./appearance";
import type { ZipArchive } from "./zip";

/** Larger model files are not read, because parsing them takes many times their size in memory. */
const MOST_BYTES = 120_000_000;

/** A 3MF property of a vertex: a colour, or a texture coordinate. */
interface Property {
  colour: Colour;
  uv: [number, number] | null;
  image: ImageBitmap | null;
}

/** One model file of the archive, with its properties and objects by id. */
interface Part {
  properties: Map<string, Property[]>;
  objects: Map<string, Element>;
}

const inside = (element: Element | Document, name: string): Element[] => [...element.getElementsByTagNameNS("*", name)];
const given = (element: Element, name: string): string | null => [...element.attributes].find((attribute) => attribute.localName === name)?.value ?? null;
const children = (element: Element, name: string): Element[] => [...element.children].filter((child) => child.localName === name);

/** Reads the appearance of a 3MF file: base materials, colour groups and textures (3MF Core Specification and Materials Extension). */
export async function read3mf(archive: ZipArchive): Promise<Appearance> {
  const parts = new Map<string, Promise<Part>>();
  const relations = await archive.read("_rels/.rels");
  const [, target] = (relations && /Target="([^"]+\.model)"/i.exec(new TextDecoder().decode(relations))) ?? [];
  const first = target ?? archive.names.find((name) => name.endsWith(".model")) ?? "";
  const root = await parsed(archive, first);
  const part = (path: string): Promise<Part> => {
    const known = parts.get(path) ?? (path === first ? Promise.resolve(root) : parsed(archive, path)).then((document) => readPart(document, archive));
    parts.set(path, known);
    return known;
  };
  const patches: Patch[] = [];
  const place = async (path: string, id: string, matrix: Matrix4, depth: number): Promise<void> => {
    const { objects, properties } = await part(path);
    const object = objects.get(id);
    if (!object || depth > 50) return;
    const [mesh] = children(object, "mesh");
    if (mesh) patches.push(...patchesOf(mesh, object, properties, matrix));
    for (const component of inside(object, "component")) {
      const own = matrix.clone().multiply(transformOf(component));
      await place(given(component, "path") ?? path, given(component, "objectid") ?? "", own, depth + 1);
    }
  };
  for (const item of inside(root, "item")) await place(given(item, "path") ?? first, given(item, "objectid") ?? "", transformOf(item), 0);
  return { patches, up: "z" };
}

async function parsed(archive: ZipArchive, path: string): Promise<Document> {
  const bytes = await archive.read(path);
  if (!bytes || bytes.length > MOST_BYTES) throw new Error("the archive has no model, or one too large for a preview");
  return new DOMParser().parseFromString(new TextDecoder().decode(bytes), "text/xml");
}

/** A 3MF transform: the rows of a matrix; points are row vectors that are multiplied from the left. */
function transformOf(element: Element): Matrix4 {
  const numbers = (given(element, "transform") ?? "").trim().split(/\s+/).map(Number);
  if (numbers.length !== 12) return new Matrix4();
  const [a, b, c, d, e, f, g, h, i, x, y, z] = numbers as [number, number, number, number, number, number, number, number, number, number, number, number];
  return new Matrix4().set(a, d, g, x, b, e, h, y, c, f, i, z, 0, 0, 0, 1);
}

async function readPart(document: Document, archive: ZipArchive): Promise<Part> {
  const properties = new Map<string, Property[]>();
  const images = new Map<string, ImageBitmap | null>();
  for (const texture of inside(document, "texture2d")) {
    const path = given(texture, "path") ?? "";
    const bytes = await archive.read(path);
    images.set(given(texture, "id") ?? "", bytes && (await readImage(bytes, given(texture, "contenttype") ?? imageType(path))));
  }
  const plain = (colour: Colour): Property => ({ colour, uv: null, image: null });
  for (const [group, member, attribute] of [["basematerials", "base", "displaycolor"], ["colorgroup", "color", "color"]] as const) {
    for (const element of inside(document, group)) {
      properties.set(given(element, "id") ?? "", children(element, member).map((entry) => plain(colourOf(given(entry, attribute)))));
    }
  }
  for (const element of inside(document, "texture2dgroup")) {
    const image = images.get(given(element, "texid") ?? "") ?? null;
    // In 3MF files, texture coordinates start at the lower edge.
    const property = (place: Element): Property => ({ colour: WHITE, image, uv: [Number(given(place, "u")), 1 - Number(given(place, "v"))] });
    properties.set(given(element, "id") ?? "", children(element, "tex2coord").map(property));
  }
  for (const element of inside(document, "multiproperties")) {
    // Only the first layer of a multi-property is shown.
    const layer = properties.get((given(element, "pids") ?? "").split(/\s+/)[0] ?? "") ?? [];
    const members = children(element, "multi").map((multi) => layer[Number((given(multi, "pindices") ?? "").split(/\s+/)[0])] ?? plain(WHITE));
    properties.set(given(element, "id") ?? "", members);
  }
  const objects = new Map(inside(document, "object").map((object) => [given(object, "id") ?? "", object]));
  return { properties, objects };
}

function colourOf(text: string | null): Colour {
  const [, r, g, b] = /^#(..)(..)(..)/.exec(text ?? "") ?? [];
  return r && g && b ? [r, g, b].map((part) => Number.parseInt(part, 16) / 255) as Colour : WHITE;
}

function patchesOf(mesh: Element, object: Element, properties: Map<string, Property[]>, matrix: Matrix4): Patch[] {
  const points = inside(mesh, "vertex").map((vertex) => new Vector3(...(["x", "y", "z"] as const).map((k) => Number(vertex.getAttribute(k)))).applyMatrix4(matrix).toArray());
  const builders = new Map<string, PatchBuilder>();
  const [ownGroup, ownIndex] = [given(object, "pid"), given(object, "pindex")];
  for (const triangle of inside(mesh, "triangle")) {
    const attribute = (name: string): string | null => triangle.getAttribute(name);
    const group = attribute("p1") === null ? ownGroup : (attribute("pid") ?? ownGroup);
    const first = attribute("p1") ?? ownIndex;
    const list = properties.get(group ?? "");
    const looks = ["p1", "p2", "p3"].map((name) => list?.[Number(attribute(name) ?? first)]);
    const image = looks[0]?.image ?? null;
    const id = `${group} ${image !== null} ${looks[0] !== undefined}`;
    let builder = builders.get(id);
    if (!builder) builders.set(id, (builder = new PatchBuilder(WHITE, image)));
    for (const [k, name] of ["v1", "v2", "v3"].entries()) {
      const point = points[Number(attribute(name))];
      if (point) builder.add(point, looks[k]?.colour ?? WHITE, image ? (looks[k]?.uv ?? [0, 0]) : null);
    }
  }
  return [...builders.values()].map((builder) => builder.build()).filter((patch) => patch !== null);
}
