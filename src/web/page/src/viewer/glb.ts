/** One kind of defect or surface in a scene, in the model's unit relative to the scene's centre. */
export interface Group {
  kind: string;
  /** Three indices into `positions` per face. */
  surface: { positions: Float32Array; indices: Uint32Array } | null;
  /** Two points per segment. */
  lines: Float32Array | null;
  dots: Float32Array | null;
}

export interface LegendEntry {
  kind: string;
  count: number;
  colour: string;
  area?: number;
}

/** A coloured mesh from the service, such as `defects.glb` or `change.glb`. */
export interface ColouredMesh {
  groups: Group[];
  legend: LegendEntry[];
  sound: string;
  /** The origin of the positions, and their scale factor if the service scaled them. */
  middle: [number, number, number];
  scale: number;
  faces: number;
}

interface Document {
  scenes: { extras?: { legend?: LegendEntry[]; sound?: string; scale?: number } }[];
  nodes: { name: string; mesh?: number; translation?: [number, number, number] }[];
  meshes?: { primitives: { mode: number; attributes: { POSITION: number }; indices?: number }[] }[];
  accessors?: { bufferView: number; count: number; componentType: number }[];
  bufferViews?: { byteOffset?: number; byteLength: number }[];
}

const MAGIC = 0x46546c67;
const [POINTS, LINES, TRIANGLES] = [0, 1, 4];

/**
 * Reads binary glTF 2.0 as the service writes it. Within the root node, z is up. The arrays are views of the
 * buffer. Files of other programs are not supported.
 */
export function readColouredMesh(buffer: ArrayBuffer): ColouredMesh {
  const head = new DataView(buffer);
  if (buffer.byteLength < 20 || head.getUint32(0, true) !== MAGIC) throw new Error("not a GLB file");
  const length = head.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length))) as Document;
  const start = 20 + length + 8;
  const place = (number: number): { at: number; count: number } => {
    const accessor = document.accessors?.[number];
    const view = accessor && document.bufferViews?.[accessor.bufferView];
    if (!accessor || !view) throw new Error("the GLB file refers to missing data");
    return { at: start + (view.byteOffset ?? 0), count: accessor.count };
  };
  const points = (number: number): Float32Array => {
    const { at, count } = place(number);
    return new Float32Array(buffer, at, 3 * count);
  };
  const groups: Group[] = [];
  for (const node of document.nodes) {
    if (node.mesh === undefined) continue;
    const group: Group = { kind: node.name, surface: null, lines: null, dots: null };
    for (const { mode, attributes, indices } of document.meshes?.[node.mesh]?.primitives ?? []) {
      const positions = points(attributes.POSITION);
      if (mode === TRIANGLES && indices !== undefined) {
        const { at, count } = place(indices);
        group.surface = { positions, indices: new Uint32Array(buffer, at, count) };
      } else if (mode === LINES) group.lines = positions;
      else if (mode === POINTS) group.dots = positions;
    }
    groups.push(group);
  }
  const { legend = [], sound = "#C4C4C4", scale = 1 } = document.scenes[0]?.extras ?? {};
  // The root's translation is in coordinates with y up.
  const [x, y, z] = document.nodes[0]?.translation ?? [0, 0, 0];
  const faces = groups.reduce((sum, group) => sum + (group.surface?.indices.length ?? 0) / 3, 0);
  return { groups, legend, sound, middle: [x, -z, y], scale, faces };
}
