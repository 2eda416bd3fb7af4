import { PerspectiveCamera, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Place } from "./places";

const FOV = 32;
const FLIGHT_MS = 650;
/** Margin around a model that fills the view. */
const MARGIN = 1.03;
/** Least size of a place for the camera distance, as a share of the model's radius. */
const NEAREST = 0.16;

/** The camera, shared by both sides so that both have the same view. The model's radius is 1. */
export class CameraControl {
  readonly camera = new PerspectiveCamera(FOV);
  readonly controls: OrbitControls;
  #flight = 0;

  constructor(canvas: HTMLElement, changed: () => void) {
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.minDistance = 0.02;
    this.controls.maxDistance = 25;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", changed);
    this.controls.addEventListener("start", () => cancelAnimationFrame(this.#flight));
  }

  /** Sets the camera up for a pane's aspect ratio. The near plane follows the distance, which keeps the depth buffer precise far away. */
  aim(aspect: number): PerspectiveCamera {
    const distance = this.camera.position.distanceTo(this.controls.target);
    this.camera.aspect = aspect;
    this.camera.near = distance * 0.02;
    this.camera.far = distance + 40;
    this.camera.updateProjectionMatrix();
    return this.camera;
  }

  /** Moves back until all points are visible in a pane of this aspect ratio. */
  home(points: readonly Vector3[], aspect: number, calm: boolean): void {
    const half = Math.tan((FOV * Math.PI) / 360);
    const back = new Vector3(0.62, -1, 0.52).normalize();
    const right = new Vector3(0, 0, 1).cross(back).normalize();
    const up = back.clone().cross(right);
    const needed = (point: Vector3): number =>
      point.dot(back) + MARGIN * Math.max(Math.abs(point.dot(right)) / (half * aspect), Math.abs(point.dot(up)) / half);
    const middle = points.reduce((sum, point) => sum.add(point), new Vector3()).divideScalar(Math.max(1, points.length));
    const distance = Math.max(0.1, ...points.map((point) => needed(point.clone().sub(middle))));
    this.#fly(middle.clone().add(back.multiplyScalar(distance)), middle, calm);
  }

  /** Moves the camera near a place, outside the model. */
  visit(place: Place, calm: boolean): void {
    const target = new Vector3(...place.at);
    const outward = target.clone();
    const looking = this.camera.position.clone().sub(this.controls.target).normalize();
    const direction = outward.length() > 0.05 ? outward.normalize().multiplyScalar(1.4).add(looking).normalize() : looking;
    if (Math.abs(direction.z) > 0.98) direction.set(0.2, -0.2, direction.z).normalize();
    const distance = Math.max(place.radius * 5.5, NEAREST * 2.2);
    this.#fly(target.clone().add(direction.multiplyScalar(distance)), target, calm);
  }

  /** Orbits the model by angles in radians, and scales the distance by a factor; for the keyboard. */
  turn(around: number, up: number, nearer: number): void {
    cancelAnimationFrame(this.#flight);
    const arm = this.camera.position.clone().sub(this.controls.target);
    const length = arm.length() * nearer;
    const flat = Math.atan2(arm.y, arm.x) + around;
    const tall = Math.min(1.54, Math.max(-1.54, Math.asin(arm.z / arm.length()) + up));
    arm.set(Math.cos(flat) * Math.cos(tall), Math.sin(flat) * Math.cos(tall), Math.sin(tall)).multiplyScalar(length);
    this.camera.position.copy(this.controls.target).add(arm);
    this.controls.update();
  }

  #fly(position: Vector3, target: Vector3, calm: boolean): void {
    cancelAnimationFrame(this.#flight);
    const [from, aim] = [this.camera.position.clone(), this.controls.target.clone()];
    const start = performance.now();
    const step = (): void => {
      const share = calm ? 1 : Math.min(1, (performance.now() - start) / FLIGHT_MS);
      const eased = 1 - (1 - share) ** 3;
      this.controls.target.lerpVectors(aim, target, eased);
      this.camera.position.lerpVectors(from, position, eased);
      this.controls.update();
      if (share < 1) this.#flight = requestAnimationFrame(step);
    };
    step();
  }

  dispose(): void {
    cancelAnimationFrame(this.#flight);
    this.controls.dispose();
  }
}
