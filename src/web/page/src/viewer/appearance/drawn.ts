import { BufferAttribute, BufferGeometry, type Material, Mesh, NoColorSpace, Object3D, RepeatWrapping, Texture } from "three";
import { type Shared, appearanceMaterial } from "../materials";
import { type Frame, toWorld } from "../model";
import type { Appearance, Patch, Up } from "./appearance";

/** Tolerance for comparing the sides of two bounding boxes of one model, as a share of the longest side. */
const TOLERANCE = 0.02;

type Point = [number, number, number];

/** The scene object of a model with its original colours and textures. Null if the file's bounding box does not match the model's. */
export function drawnAppearance(appearance: Appearance, model: Frame, frame: Frame, plain: string, common: Shared): Object3D | null {
  const place = alignment(appearance, model, frame);
  if (!place) return null;
  const root = new Object3D();
  const textures = new Map<ImageBitmap, Texture>();
  for (const patch of appearance.patches) root.add(meshOf(patch, place, plain, common, textures));
  return root;
}

function meshOf(patch: Patch, place: (point: Point) => Point, plain: string, common: Shared, textures: Map<ImageBitmap, Texture>): Mesh {
  const geometry = new BufferGeometry();
  const positions = new Float32Array(patch.positions.length);
  for (let i = 0; i < positions.length; i += 3) positions.set(place([patch.positions[i]!, patch.positions[i + 1]!, patch.positions[i + 2]!]), i);
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  if (patch.indices) geometry.setIndex(new BufferAttribute(patch.indices, 1));
  if (patch.colours) geometry.setAttribute("tint", new BufferAttribute(patch.colours, 3));
  if (patch.uvs) geometry.setAttribute("place", new BufferAttribute(patch.uvs, 2));
  const mesh = new Mesh(geometry, appearanceMaterial(patch, patch.image && textureOf(patch.image, textures), plain, common));
  mesh.frustumCulled = false;
  return mesh;
}

function textureOf(image: ImageBitmap, textures: Map<ImageBitmap, Texture>): Texture {
  const known = textures.get(image);
  if (known) return known;
  const texture = new Texture(image);
  texture.flipY = false;
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.colorSpace = NoColorSpace;
  texture.needsUpdate = true;
  textures.set(image, texture);
  return texture;
}

/**
 * The transform from a file's coordinates to the world. Comparing bounding boxes finds a different unit or up axis. A file whose box does not
 * match, up to a scale, is not the model.
 */
function alignment({ patches, up }: Appearance, model: Frame, frame: Frame): ((point: Point) => Point) | null {
  const own = (point: Point): Point => between(point, up, model.up);
  const min: Point = [Infinity, Infinity, Infinity];
  const max: Point = [-Infinity, -Infinity, -Infinity];
  for (const { positions, indices } of patches) {
    const count = indices?.length ?? positions.length / 3;
    for (let i = 0; i < count; i += 1) {
      const v = indices ? indices[i]! : i;
      const point = own([positions[3 * v]!, positions[3 * v + 1]!, positions[3 * v + 2]!]);
      for (let k = 0; k < 3; k += 1) {
        if (point[k]! < min[k]!) min[k] = point[k]!;
        if (point[k]! > max[k]!) max[k] = point[k]!;
      }
    }
  }
  const [sides, wanted] = [min.map((x, k) => max[k]! - x), model.min.map((x, k) => model.max[k]! - x)];
  const longest = Math.max(...wanted);
  const scale = longest / Math.max(...sides);
  if (!Number.isFinite(scale) || sides.some((side, k) => Math.abs(side * scale - wanted[k]!) > TOLERANCE * longest)) return null;
  return (point) => {
    const at = own(point).map((x, k) => (x - min[k]!) * scale + model.min[k]!);
    return toWorld(frame, at);
  };
}

/** Converts a point between coordinate systems with different up axes. */
function between([x, y, z]: Point, from: Up | null, to: Up): Point {
  if (from === null || from === to) return [x, y, z];
  return from === "y" ? [x, -z, y] : [x, z, -y];
}

export function disposeOfAppearance(root: Object3D | null): void {
  root?.traverse((object) => {
    const mesh = object as Partial<Mesh>;
    mesh.geometry?.dispose();
    (mesh.material as Material | undefined)?.dispose();
  });
  root?.removeFromParent();
}
