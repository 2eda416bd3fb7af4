import { BufferAttribute, BufferGeometry, type Camera, Line, LineBasicMaterial, type Mesh, type Object3D, Raycaster, Vector2, Vector3, type Vector4 } from "three";
import { srgb } from "./materials";

/** Within this many pixels of the pointer, a vertex is picked instead of the point under the pointer. */
const SNAP = 10;

/**
 * The point of some surfaces under a point of a pane, in the world: the nearest to the camera that is not cut off. `at` is from -1 to 1,
 * and `half` is half of the pane's size in pixels.
 */
export function placeUnder(surfaces: Mesh[], camera: Camera, at: Vector2, half: Vector2, cut: Vector4): Vector3 | null {
  const ray = new Raycaster();
  ray.setFromCamera(at, camera);
  const isKept = (point: Vector3): boolean => point.x * cut.x + point.y * cut.y + point.z * cut.z <= cut.w;
  const hit = ray.intersectObjects(surfaces, false).find(({ point }) => isKept(point));
  if (!hit) return null;
  const pixels = (point: Vector3): Vector2 => {
    const seen = point.clone().project(camera);
    return new Vector2(seen.x, seen.y).multiply(half);
  };
  const pointer = at.clone().multiply(half);
  const mesh = hit.object as Mesh<BufferGeometry>;
  const positions = mesh.geometry.getAttribute("position");
  const corners = hit.face ? [hit.face.a, hit.face.b, hit.face.c].map((v) => new Vector3().fromBufferAttribute(positions, v).applyMatrix4(mesh.matrixWorld)) : [];
  const near = corners
    .filter(isKept)
    .map((corner) => ({ corner, far: pixels(corner).distanceTo(pointer) }))
    .sort((a, b) => a.far - b.far)[0];
  return near && near.far <= SNAP ? near.corner : hit.point;
}

/** A line between two points of the world, visible through the model. */
export function rulerLine(a: Vector3, b: Vector3): Object3D {
  const points = Float32Array.from([...a.toArray(), ...b.toArray()]);
  const material = new LineBasicMaterial({ depthTest: false, transparent: true });
  material.color.copy(srgb("#d6336c"));
  const line = new Line(new BufferGeometry().setAttribute("position", new BufferAttribute(points, 3)), material);
  line.renderOrder = 10;
  line.frustumCulled = false;
  return line;
}
