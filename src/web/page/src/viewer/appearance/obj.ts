import { type Appearance, type Beside, type Colour, PatchBuilder, WHITE, imageType, readImage } from "./appearance";

interface Material {
  colour: Colour;
  image: ImageBitmap | null;
}

/** Reads the appearance of an OBJ file: vertex colours, and the colours (`Kd`) and textures (`map_Kd`) of its materials. */
export async function readObj(bytes: Uint8Array, beside: Beside): Promise<Appearance> {
  const text = new TextDecoder().decode(bytes).replaceAll("\\\n", " ");
  const materials = new Map<string, Material>();
  for (const [, names] of text.matchAll(/^\s*mtllib\s+(.+?)\s*$/gm)) {
    const list = await beside(names!);
    if (list) await readMaterials(new TextDecoder().decode(list), beside, materials);
  }
  const points: number[][] = [];
  const places: number[][] = [];
  const builders = new Map<string, PatchBuilder>();
  let name = "";
  const at = (list: number[][], word: string | undefined): number[] | undefined => {
    const index = Number.parseInt(word ?? "", 10);
    return list[index < 0 ? list.length + index : index - 1];
  };
  for (const line of text.split("\n")) {
    const [key, ...words] = line.trim().split(/\s+/);
    if (key === "v") points.push(words.map(Number));
    // In OBJ files, texture coordinates start at the lower edge.
    else if (key === "vt") places.push([Number(words[0]), 1 - Number(words[1] ?? 0)]);
    else if (key === "usemtl") name = words.join(" ");
    else if (key === "f") {
      const corners = words.map((word) => word.split("/")).map(([v, vt]) => ({ point: at(points, v), place: at(places, vt) }));
      const isTinted = corners.every(({ point }) => (point?.length ?? 0) >= 6);
      const isPlaced = corners.every(({ place }) => place !== undefined);
      const { colour, image } = materials.get(name) ?? { colour: WHITE, image: null };
      const id = `${name} ${isTinted} ${isPlaced}`;
      let builder = builders.get(id);
      if (!builder) builders.set(id, (builder = new PatchBuilder(colour, isPlaced ? image : null)));
      for (let i = 2; i < corners.length; i += 1) {
        for (const { point, place } of [corners[0]!, corners[i - 1]!, corners[i]!]) {
          if (point) builder.add(point, isTinted ? point.slice(3, 6) : null, isPlaced ? place! : null);
        }
      }
    }
  }
  return { patches: [...builders.values()].map((builder) => builder.build()).filter((patch) => patch !== null), up: null };
}

async function readMaterials(text: string, beside: Beside, materials: Map<string, Material>): Promise<void> {
  let now: Material = { colour: WHITE, image: null };
  for (const line of text.split("\n")) {
    const [, key = "", rest = ""] = /^\s*(\S+)\s+(.*?)\s*$/.exec(line) ?? [];
    if (key === "newmtl") materials.set(rest, (now = { colour: WHITE, image: null }));
    else if (key === "Kd") now.colour = rest.split(/\s+/).slice(0, 3).map(Number) as Colour;
    else if (key.toLowerCase() === "map_kd") {
      // Options precede the file name.
      const name = rest.replace(/^(-\w+\s+([\d.+-]+\s+|on\s+|off\s+)*)+/, "");
      const bytes = await beside(name);
      now.image = bytes && (await readImage(bytes, imageType(name)));
    }
  }
}
