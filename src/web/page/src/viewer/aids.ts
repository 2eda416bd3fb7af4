import { BufferAttribute, BufferGeometry, DoubleSide, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, Object3D, Points, type ShaderMaterial, Vector3 } from "three";
import { type Frame, toWorld } from "./model";
import { srgb } from "./materials";

/** A bounding box in the world. */
export interface Box {
  min: Vector3;
  max: Vector3;
}

/** The twelve edges of a box. */
function boxLines(box: Box): Float32Array {
  const eight = corners(box);
  const at = (i: number): number[] => eight[i]!.toArray();
  const edges = [0, 1, 2, 3, 4, 5, 6, 7, 0, 2, 1, 3, 4, 6, 5, 7, 0, 4, 1, 5, 2, 6, 3, 7];
  return Float32Array.from(edges.flatMap(at));
}

function lines(points: Float32Array, colour: string, opacity: number): LineSegments {
  const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(points, 3));
  const material = new LineBasicMaterial({ transparent: true, opacity, depthWrite: false });
  material.color.copy(srgb(colour));
  return new LineSegments(geometry, material);
}

export function inWorld(frame: Frame, point: readonly number[]): Vector3 {
  return new Vector3(...toWorld(frame, point));
}

/** The corners of a box. */
export function corners({ min, max }: Box): Vector3[] {
  return Array.from({ length: 8 }, (_, i) => new Vector3(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z));
}

/** The lines of the model's bounding box, and the midpoints of edges along x, y and z for the length labels. */
export function sizeBox(frame: Frame): { object: Object3D; labels: Vector3[] } {
  const { min, max } = boxOf(frame);
  const middle = min.clone().add(max).multiplyScalar(0.5);
  const labels = [new Vector3(middle.x, min.y, min.z), new Vector3(max.x, middle.y, min.z), new Vector3(max.x, min.y, middle.z)];
  if (frame.up === "y") labels.push(labels.splice(1, 1)[0]!);
  return { object: lines(boxLines({ min, max }), "#8a94a6", 0.75), labels };
}

/** The bounding box of a model in the world. */
export function boxOf(frame: Frame): Box {
  const [a, b] = [inWorld(frame, frame.min), inWorld(frame, frame.max)];
  return { min: a.clone().min(b), max: a.clone().max(b) };
}

/** The build volume of a printer, with the model in the middle of its floor. `size` is in the model's unit; its last number is the height. */
export function buildVolumeOf(frame: Frame, size: readonly number[]): Box {
  const box = boxOf(frame);
  const middle = box.min.clone().add(box.max).multiplyScalar(0.5).setZ(box.min.z);
  const [x, y, z] = size.map((side) => side / frame.radius) as [number, number, number];
  return { min: middle.clone().sub(new Vector3(x / 2, y / 2, 0)), max: middle.clone().add(new Vector3(x / 2, y / 2, z)) };
}

/** The lines and floor of a build volume; the colour shows whether the model fits. */
export function buildVolumeObject({ min, max }: Box, fits: boolean): Object3D {
  const buildVolume = new Object3D();
  buildVolume.add(lines(boxLines({ min, max }), fits ? "#2f9e7f" : "#d1453b", 0.9));
  const grid: number[] = [];
  for (let i = 1; i < 10; i += 1) {
    const [x, y] = [min.x + ((max.x - min.x) * i) / 10, min.y + ((max.y - min.y) * i) / 10];
    grid.push(x, min.y, min.z, x, max.y, min.z, min.x, y, min.z, max.x, y, min.z);
  }
  buildVolume.add(lines(Float32Array.from(grid), "#8a94a6", 0.35));
  const corners = [min.x, min.y, max.x, min.y, max.x, max.y, min.x, min.y, max.x, max.y, min.x, max.y];
  const sheet = Float32Array.from({ length: 18 }, (_, i) => (i % 3 === 2 ? min.z : corners[Math.floor(i / 3) * 2 + (i % 3)]!));
  const material = new MeshBasicMaterial({ transparent: true, opacity: 0.08, side: DoubleSide, depthWrite: false });
  material.color.copy(srgb(fits ? "#2f9e7f" : "#d1453b"));
  buildVolume.add(new Mesh(new BufferGeometry().setAttribute("position", new BufferAttribute(sheet, 3)), material));
  return buildVolume;
}

/** Dots at points of the world. */
export function spots(points: Vector3[], material: ShaderMaterial): Points {
  const positions = Float32Array.from(points.flatMap((point) => point.toArray()));
  const dots = new Points(new BufferGeometry().setAttribute("position", new BufferAttribute(positions, 3)), material);
  dots.frustumCulled = false;
  dots.renderOrder = 4;
  return dots;
}

export function disposeOf(object: Object3D | null): void {
  object?.traverse((child) => {
    const drawn = child as Partial<Mesh<BufferGeometry, LineBasicMaterial>>;
    drawn.geometry?.dispose();
    drawn.material?.dispose();
  });
  object?.removeFromParent();
}
