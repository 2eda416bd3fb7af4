import { BufferAttribute, BufferGeometry, type Material, Mesh, Object3D, type Plane, Points, ShaderMaterial } from "three";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import type { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import type { ColouredMesh, Group } from "./glb";
import { styleOf } from "./kind-styles";
import { NEARER, type Shared, dotMaterial, lineMaterial, surfaceMaterial, wireMaterial } from "./materials";

/** The transform from the model's unit to the world, where the model has radius 1. Models of any size then fit in f32. */
export interface Frame {
  centre: [number, number, number];
  radius: number;
  /** The corners of the bounding box in the model's unit. */
  min: [number, number, number];
  max: [number, number, number];
  /** The model's up axis; the world's up axis is z. */
  up: "y" | "z";
}

/** Rotates a direction of the model into the world, where z is up. */
export function turned([x, y, z]: readonly [number, number, number], up: Frame["up"]): [number, number, number] {
  return up === "y" ? [x, -z, y] : [x, y, z];
}

/** Transforms a point from the model's unit to the world. */
export function toWorld(frame: Frame, point: readonly number[]): [number, number, number] {
  const [x, y, z] = point.map((part, k) => (part - frame.centre[k]!) / frame.radius);
  return turned([x!, y!, z!], frame.up);
}

/** Transforms a point from the world to the model's unit. */
export function fromWorld(frame: Frame, [x, y, z]: readonly [number, number, number]): [number, number, number] {
  const own = frame.up === "y" ? [x, z, -y] : [x, y, z];
  return own.map((part, k) => part * frame.radius + frame.centre[k]!) as [number, number, number];
}

/** The kinds of surface without defects or changes, which most of a model has. */
const PLAIN = new Set(["sound", "kept"]);
const LINE_WIDTH = 3.2;
const RIM = "#1c1c20";

export function frameOf(mesh: ColouredMesh, up: Frame["up"] = "z"): Frame {
  const min = [Infinity, Infinity, Infinity];
  const max = [-Infinity, -Infinity, -Infinity];
  for (const { surface, lines, dots } of mesh.groups) {
    for (const points of [surface?.positions, lines, dots]) {
      if (!points) continue;
      for (let i = 0; i < points.length; i += 3) {
        for (let k = 0; k < 3; k += 1) {
          const x = points[i + k]!;
          if (x < min[k]!) min[k] = x;
          if (x > max[k]!) max[k] = x;
        }
      }
    }
  }
  const own = (x: number, k: number): number => (x + mesh.middle[k]!) / mesh.scale;
  const [low, high] = min[0]! <= max[0]! ? [min.map(own), max.map(own)] : [[0, 0, 0], [0, 0, 0]];
  const centre = low.map((x, k) => (x + high[k]!) / 2);
  const radius = Math.hypot(...low.map((x, k) => high[k]! - x)) / 2 || 1;
  return { centre, radius, min: low, max: high, up } as Frame;
}

/** The scene objects of a coloured mesh: for each kind its surface, lines and dots, which can be shown or hidden. */
export class Model {
  readonly root = new Object3D();
  readonly #surfaces = new Map<string, Mesh<BufferGeometry, ShaderMaterial>>();
  readonly #marks = new Map<string, Object3D[]>();
  readonly #lines: LineMaterial[] = [];
  readonly #wires: Mesh[] = [];
  readonly #shared: Shared;
  /** Kinds that are drawn as lines or dots; their surface is only tinted. */
  readonly #tinted = new Set<string>();
  #isOnlyMarked = false;

  /** Hidden kinds of an overlay are not drawn; hidden kinds of a model are drawn plain. */
  constructor(
    readonly mesh: ColouredMesh,
    frame: Frame,
    common: Shared,
    readonly isOverlay: boolean,
    kinds: (kind: string) => boolean = () => true,
  ) {
    this.#shared = common;
    const grow = 1 / (mesh.scale * frame.radius);
    this.root.scale.setScalar(grow);
    this.root.position.fromArray(toWorld(frame, mesh.middle.map((x) => x / mesh.scale)));
    if (frame.up === "y") this.root.rotation.x = Math.PI / 2;
    const colours = new Map(mesh.legend.map((entry) => [entry.kind, entry.colour]));
    const dash = 0.02 / grow;
    for (const group of mesh.groups) {
      if (kinds(group.kind)) this.#add(group, colours.get(group.kind) ?? mesh.sound, dash);
    }
    this.root.updateMatrixWorld(true);
  }

  #add(group: Group, colour: string, dash: number): void {
    const look = styleOf(group.kind);
    const plain = PLAIN.has(group.kind);
    if (group.surface) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(group.surface.positions, 3));
      geometry.setIndex(new BufferAttribute(group.surface.indices, 1));
      // Surface next to lines and dots is only tinted.
      const tinted = group.lines || (group.dots && !["crossing", "needless"].includes(look.family));
      if (tinted) this.#tinted.add(group.kind);
      const shown = tinted ? mixed(colour, this.mesh.sound, 0.55) : colour;
      const material = surfaceMaterial(plain ? this.mesh.sound : shown, this.mesh.sound, plain || tinted ? null : look, this.isOverlay, this.#shared);
      const surface = new Mesh(geometry, material);
      surface.frustumCulled = false;
      this.#surfaces.set(group.kind, surface);
      this.root.add(surface);
    }
    const marks: Object3D[] = [];
    if (group.lines) {
      const geometry = new LineSegmentsGeometry().setPositions(group.lines);
      for (const [tone, width, order] of [[RIM, LINE_WIDTH + 2.2, 1], [colour, LINE_WIDTH, 2]] as const) {
        const material = lineMaterial(tone, width, look.dashed && order === 2, dash);
        const lines = new LineSegments2(geometry, material);
        if (look.dashed && order === 2) lines.computeLineDistances();
        lines.renderOrder = order;
        lines.frustumCulled = false;
        this.#lines.push(material);
        marks.push(lines);
      }
    }
    if (group.dots) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(group.dots, 3));
      const dots = new Points(geometry, dotMaterial(colour, look, dotSize(group.dots.length / 3), this.#shared));
      dots.frustumCulled = false;
      dots.renderOrder = 3;
      marks.push(dots);
    }
    for (const mark of marks) this.root.add(mark);
    this.#marks.set(group.kind, marks);
  }

  show(kind: string, shown: boolean): void {
    const surface = this.#surfaces.get(kind);
    if (surface) {
      surface.material.uniforms["shown"]!.value = shown;
      surface.visible = this.#isDrawn(kind, shown);
    }
    for (const mark of this.#marks.get(kind) ?? []) mark.visible = shown;
  }

  /** Hides or shows the surface without defects, so that the defects can be drawn over original colours. */
  showOnlyMarked(isOn: boolean): void {
    this.#isOnlyMarked = isOn;
    for (const [kind, surface] of this.#surfaces) {
      surface.material.uniforms["nearer"]!.value = isOn || this.isOverlay ? NEARER.overlay : 0;
      surface.visible = this.#isDrawn(kind, Boolean(surface.material.uniforms["shown"]!.value));
    }
  }

  #isDrawn(kind: string, shown: boolean): boolean {
    if (this.#isOnlyMarked && (PLAIN.has(kind) || this.#tinted.has(kind))) return false;
    return shown || !(this.isOverlay || this.#isOnlyMarked);
  }

  /** All surfaces, for picking with a pointer. */
  get surfaces(): Mesh[] {
    return [...this.#surfaces.values()];
  }

  /** Shows or hides the edges of all faces. */
  wire(shown: boolean): void {
    if (shown && this.#wires.length === 0) {
      const material = wireMaterial(this.#shared);
      for (const surface of this.#surfaces.values()) {
        const wire = new Mesh(surface.geometry, material);
        wire.frustumCulled = false;
        this.#wires.push(wire);
        this.root.add(wire);
      }
      this.root.updateMatrixWorld(true);
    }
    for (const wire of this.#wires) wire.visible = shown;
  }

  cut(planes: Plane[] | null): void {
    for (const material of this.#lines) material.clippingPlanes = planes;
  }

  dispose(): void {
    this.root.traverse((object) => {
      const it = object as Partial<Mesh>;
      it.geometry?.dispose();
      (it.material as Material | undefined)?.dispose();
    });
    this.root.removeFromParent();
  }
}

/** The size of dots: the more dots, the smaller, so that the surface stays visible. */
export function dotSize(count: number): number {
  return count <= 30 ? 13 : count <= 150 ? 9 : 5;
}

function mixed(a: string, b: string, share: number): string {
  const [x, y] = [Number.parseInt(a.slice(1), 16), Number.parseInt(b.slice(1), 16)];
  const channel = (shift: number): number => Math.round(((x >> shift) & 255) * (1 - share) + ((y >> shift) & 255) * share);
  return `#${((channel(16) << 16) | (channel(8) << 8) | channel(0)).toString(16).padStart(6, "0")}`;
}
