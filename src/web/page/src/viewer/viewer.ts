import { LinearSRGBColorSpace, type Object3D, Plane, Scene, Vector2, Vector3, Vector4, WebGLRenderer } from "three";
import { type Box, boxOf, corners, disposeOf, inWorld, buildVolumeObject, buildVolumeOf, sizeBox, spots } from "./aids";
import type { Appearance } from "./appearance/appearance";
import { disposeOfAppearance, drawnAppearance } from "./appearance/drawn";
import { CameraControl } from "./camera";
import type { Point } from "./distance";
import type { ColouredMesh } from "./glb";
import { type Mode, type Pane, type SideName, panes } from "./layout";
import { isShownAtFirst, styleOf } from "./kind-styles";
import { dotMaterial, shared } from "./materials";
import { type Frame, Model, dotSize, frameOf, fromWorld, turned } from "./model";
import { type Place, placesOf } from "./places";
import { placeUnder, rulerLine } from "./ruler";
import { MOST_FACES, type Sheet, drawnShell, openParts } from "./shell";

export type Axis = "x" | "y" | "z";
export type Level = "fine" | "coarse";

/** A label or mark over the canvas at a point of the model. */
interface Pin {
  /** One element per pane, if both sides have separate panes. */
  elements: HTMLElement[];
  at: Vector3;
}

interface Side {
  scene: Scene;
  /** The full model, and a coarse one that replaces it while the camera moves and rendering is slow. */
  fine: Model | null;
  coarse: Model | null;
  /** Overlays, each for one level of detail. */
  overlays: { level: Level; model: Model }[];
  /** The model with its original colours. */
  appearance: Object3D | null;
}

/** The colour of a previewed solid. */
const SHELL_COLOUR = "#2f9e8f";

/** Frames longer than this, in milliseconds, count as slow. */
const SLOW = 70;
/** Time without movement after which the camera counts as resting, in milliseconds. */
const REST = 160;

/** Shows a model before and after the repair on one canvas with one camera. It does not know about jobs or the service. */
export class Viewer {
  readonly #renderer: WebGLRenderer;
  readonly #cameraControl: CameraControl;
  readonly #common = shared();
  readonly #sides: Record<SideName, Side>;
  readonly #aids = new Scene();
  readonly #observer: ResizeObserver;
  readonly #shown = new Map<string, boolean>();
  readonly #calm = matchMedia("(prefers-reduced-motion: reduce)");
  #frame: Frame | null = null;
  #mode: Mode = "both";
  #wipe = 0.5;
  #wire = false;
  #cut: Plane | null = null;
  #size: { object: Object3D; labels: Vector3[] } | null = null;
  #buildVolume: Object3D | null = null;
  #buildVolumeBox: Box | null = null;
  readonly #spots = new Map<string, Object3D>();
  #pins: Pin[] = [];
  #ring: Pin | null = null;
  #ruler: { pins: Pin[]; line: Object3D | null } = { pins: [], line: null };
  #cross: HTMLElement | null = null;
  #hasColours = true;
  #sheet: Sheet | null = null;
  #shell: Object3D | null = null;
  #asked = 0;
  #askedAt = 0;
  #moving = 0;
  #last = 0;
  #resting: ReturnType<typeof setTimeout> | undefined;
  #slow = false;
  #isHome = true;
  /** Called after each frame. */
  drawn: (() => void) | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    /** The element for labels over the canvas, of the same size. */
    readonly over: HTMLElement,
    /** The model's up axis. */
    readonly up: Frame["up"] = "z",
  ) {
    this.#renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.#renderer.outputColorSpace = LinearSRGBColorSpace;
    this.#renderer.localClippingEnabled = true;
    this.#renderer.autoClear = false;
    const side = (): Side => ({ scene: new Scene(), fine: null, coarse: null, overlays: [], appearance: null });
    this.#sides = { before: side(), after: side() };
    this.#cameraControl = new CameraControl(canvas, () => this.#moved());
    this.#cameraControl.controls.addEventListener("start", () => {
      this.#isHome = false;
    });
    this.#observer = new ResizeObserver(() => this.#resize());
    this.#observer.observe(canvas);
    this.#resize();
  }

  /** Shows a mesh on one side, in full or coarse. The first mesh positions the camera. */
  show(name: SideName, mesh: ColouredMesh, level: Level, kinds?: (kind: string) => boolean): void {
    const isFirst = this.#frame === null;
    this.#frame ??= frameOf(mesh, this.up);
    const side = this.#sides[name];
    side[level]?.dispose();
    const model = new Model(mesh, this.#frame, this.#common, false, kinds);
    side[level] = model;
    this.#adopt(side, model);
    // A second side makes the first pane smaller.
    if (isFirst || this.#isHome) this.home(true);
  }

  /** Draws some kinds of a mesh over the full or coarse mesh of one side. */
  lay(name: SideName, mesh: ColouredMesh, level: Level, kinds: (kind: string) => boolean): void {
    if (!this.#frame) return;
    const side = this.#sides[name];
    const model = new Model(mesh, this.#frame, this.#common, true, kinds);
    side.overlays.push({ level, model });
    this.#adopt(side, model);
  }

  /** Shows the input and the result. Removed surface appears on the input, where it still exists. */
  compare(before: ColouredMesh | null, change: ColouredMesh | null, level: Level): void {
    if (before) this.show("before", before, level);
    if (change) this.show("after", change, level, (kind) => kind !== "removed");
    if (before && change) this.lay("before", change, level, (kind) => kind === "removed");
  }

  #adopt(side: Side, model: Model): void {
    for (const { kind } of model.mesh.groups) model.show(kind, this.#shown.get(kind) ?? isShownAtFirst(kind));
    model.wire(this.#wire && !model.isOverlay);
    model.cut(this.#cut && [this.#cut]);
    model.showOnlyMarked(this.#hasColours && side.appearance !== null);
    side.scene.add(model.root);
    this.invalidate();
  }

  /** Gives one side the original colours. Returns whether the file belongs to the shown model. */
  setAppearance(name: SideName, appearance: Appearance): boolean {
    const side = this.#sides[name];
    const mesh = (side.fine ?? side.coarse)?.mesh;
    disposeOfAppearance(side.appearance);
    // Removed surface is not part of the result.
    const whole = mesh && { ...mesh, groups: mesh.groups.filter(({ kind }) => name === "before" || kind !== "removed") };
    side.appearance = (this.#frame && whole && drawnAppearance(appearance, frameOf(whole, this.up), this.#frame, whole.sound, this.#common)) ?? null;
    if (side.appearance) side.scene.add(side.appearance);
    this.showColours(this.#hasColours);
    return side.appearance !== null;
  }

  /** Shows models in their original colours, or in grey. */
  showColours(shown: boolean): void {
    this.#hasColours = shown;
    for (const { fine, coarse, overlays, appearance } of Object.values(this.#sides)) {
      for (const model of [fine, coarse, ...overlays.map((overlay) => overlay.model)]) model?.showOnlyMarked(shown && appearance !== null);
    }
    this.invalidate();
  }

  /**
   * Draws the model's open parts as a solid of the given thickness, in the model's unit; null removes the preview. Returns whether
   * there are open parts to draw.
   */
  setShell(thickness: number | null): boolean {
    disposeOf(this.#shell);
    this.#shell = null;
    const model = this.#sides.before.fine ?? this.#sides.before.coarse;
    if (thickness !== null && model && model.mesh.faces <= MOST_FACES) {
      this.#sheet ??= openParts(model.mesh);
      if (this.#sheet.faces.length > 0) {
        this.#shell = drawnShell(this.#sheet, thickness * model.mesh.scale, SHELL_COLOUR, this.#common);
        const { scene } = this.#sides.after.fine ? this.#sides.after : this.#sides.before;
        for (const name of ["position", "quaternion", "scale"] as const) this.#shell[name].copy(model.root[name] as never);
        scene.add(this.#shell);
      }
    }
    this.invalidate();
    return this.#shell !== null;
  }

  /** The point of the model under a pointer, in the model's unit; without a pointer, under the middle of the first pane. */
  pick(pointer: { clientX: number; clientY: number } | null): Point | null {
    const frame = this.#frame;
    const all = this.#panes();
    const box = this.canvas.getBoundingClientRect();
    const [first] = all;
    if (!frame || !first) return null;
    const [left, bottom, width, height] = first.view;
    const x = pointer ? pointer.clientX - box.left : left + width / 2;
    const y = pointer ? box.bottom - pointer.clientY : bottom + height / 2;
    const pane = pointer ? all.find(({ scissor: [l, b, w, h] }) => x >= l && x < l + w && y >= b && y < b + h) : first;
    const side = pane && this.#sides[pane.side];
    const model = side?.fine ?? side?.coarse;
    if (!pane || !model) return null;
    const half = new Vector2(pane.view[2] / 2, pane.view[3] / 2);
    const at = new Vector2((x - pane.view[0]) / half.x - 1, (y - pane.view[1]) / half.y - 1);
    const camera = this.#cameraControl.aim(half.x / half.y);
    camera.updateMatrixWorld();
    const found = placeUnder(model.surfaces, camera, at, half, this.#common.cut.value);
    return found && fromWorld(frame, found.toArray());
  }

  /** Shows or hides a cross at the point that `pick` uses without a pointer. */
  showCross(shown: boolean): void {
    this.#cross?.remove();
    this.#cross = shown ? this.#write("cross", "") : null;
    this.invalidate();
  }

  /** Marks up to two points of the model, and labels the line between them. */
  setRuler(points: readonly Point[], text: string): void {
    const frame = this.#frame;
    for (const { elements } of this.#ruler.pins) for (const element of elements) element.remove();
    disposeOf(this.#ruler.line);
    this.#ruler = { pins: [], line: null };
    if (frame) {
      const ends = points.map((point) => inWorld(frame, point));
      const pin = (kind: string, label: string, at: Vector3): Pin => ({ at, elements: [this.#write(kind, label), this.#write(kind, label)] });
      this.#ruler.pins = ends.map((at) => pin("end", "", at));
      const [a, b] = ends;
      if (a && b) {
        this.#ruler.pins.push(pin("length", text, a.clone().add(b).multiplyScalar(0.5)));
        this.#ruler.line = rulerLine(a, b);
        this.#aids.add(this.#ruler.line);
      }
    }
    this.invalidate();
  }

  /** The model's bounding box in its own unit, and the transform to the world. */
  get frame(): Frame | null {
    return this.#frame;
  }

  #models(): Model[] {
    const of = ({ fine, coarse, overlays }: Side): (Model | null)[] => [fine, coarse, ...overlays.map(({ model }) => model)];
    return [...of(this.#sides.before), ...of(this.#sides.after)].filter((model) => model !== null);
  }

  showKind(kind: string, shown: boolean): void {
    this.#shown.set(kind, shown);
    for (const model of this.#models()) model.show(kind, shown);
    this.invalidate();
  }

  /** The places of a kind in the world, largest first. */
  places(kind: string): Place[] {
    const frame = this.#frame;
    const model = this.#models().find(({ mesh }) => mesh.groups.some((group) => group.kind === kind));
    const group = model?.mesh.groups.find((candidate) => candidate.kind === kind);
    if (!frame || !model || !group) return [];
    const { middle, scale } = model.mesh;
    return placesOf(group).map(({ at, radius }) => {
      const own = at.map((x, k) => (x + middle[k]!) / scale);
      return { at: inWorld(frame, own).toArray(), radius: radius / scale / frame.radius };
    });
  }

  /** Converts a point in the model's unit to a place. */
  placeAt(point: readonly number[]): Place | null {
    return this.#frame && { at: inWorld(this.#frame, point).toArray(), radius: 0 };
  }

  visit(place: Place): void {
    this.#isHome = false;
    this.#mark(new Vector3(...place.at));
    this.#cameraControl.visit(place, this.#calm.matches);
  }

  home(calm = this.#calm.matches): void {
    this.#isHome = true;
    this.#mark(null);
    const pane = this.#panes()[0];
    const box = this.#buildVolumeBox ?? (this.#frame && boxOf(this.#frame));
    if (pane && box) this.#cameraControl.home(corners(box), pane.view[2] / Math.max(1, pane.view[3]), calm);
  }

  turn(around: number, up: number, nearer = 1): void {
    this.#isHome = false;
    this.#cameraControl.turn(around, up, nearer);
  }

  setMode(mode: Mode): void {
    this.#mode = mode;
    if (this.#isHome) this.home(true);
    this.invalidate();
  }

  /** Position of the divider between the two sides, as a share of the width. */
  setWipe(share: number): void {
    this.#wipe = share;
    this.invalidate();
  }

  setWire(shown: boolean): void {
    this.#wire = shown;
    for (const model of this.#models()) if (!model.isOverlay) model.wire(shown);
    this.invalidate();
  }

  /** Cuts the model at a share (0 to 1) of its box along an axis; null removes the cut. */
  setCut(axis: Axis | null, share: number): void {
    const frame = this.#frame;
    if (axis === null || !frame) {
      this.#cut = null;
      this.#common.cut.value.set(0, 0, 0, 1);
    } else {
      const k = "xyz".indexOf(axis);
      const normal = new Vector3(...turned(new Vector3().setComponent(k, 1).toArray(), frame.up));
      const at = (frame.min[k]! + (frame.max[k]! - frame.min[k]!) * share - frame.centre[k]!) / frame.radius;
      this.#common.cut.value = new Vector4(normal.x, normal.y, normal.z, at);
      this.#cut = new Plane(normal.negate(), at);
      // All materials share the uniform object, so only its vector is replaced.
    }
    for (const model of this.#models()) model.cut(this.#cut && [this.#cut]);
    this.invalidate();
  }

  /** Labels the sides of the bounding box; null removes the labels. */
  setSizes(texts: [string, string, string] | null): void {
    disposeOf(this.#size?.object ?? null);
    for (const { elements } of this.#pins) for (const element of elements) element.remove();
    this.#pins = [];
    this.#size = texts && this.#frame ? sizeBox(this.#frame) : null;
    if (this.#size && texts) {
      this.#aids.add(this.#size.object);
      for (const [i, at] of this.#size.labels.entries()) this.#pins.push({ elements: [this.#write("length", texts[i]!)], at });
    }
    this.invalidate();
  }

  /** Marks points of the result with the dots of a kind; an empty list removes them. */
  setSpots(kind: string, points: readonly (readonly number[])[], colour: string): void {
    const frame = this.#frame;
    disposeOf(this.#spots.get(kind) ?? null);
    this.#spots.delete(kind);
    if (frame && points.length > 0) {
      const dots = spots(points.map((point) => inWorld(frame, point)), dotMaterial(colour, styleOf(kind), dotSize(points.length), this.#common));
      this.#spots.set(kind, dots);
      (this.#sides.after.fine ?? this.#sides.after.coarse ? this.#sides.after : this.#sides.before).scene.add(dots);
    }
    this.invalidate();
  }

  /** Draws a printer's build volume, its size in the model's unit; null removes it. */
  setBuildVolume(size: readonly number[] | null, fits: boolean): void {
    disposeOf(this.#buildVolume);
    this.#buildVolumeBox = size && this.#frame && buildVolumeOf(this.#frame, size);
    this.#buildVolume = this.#buildVolumeBox && buildVolumeObject(this.#buildVolumeBox, fits);
    if (this.#buildVolume) this.#aids.add(this.#buildVolume);
    if (this.#isHome) this.home();
    this.invalidate();
  }

  #write(kind: string, text: string): HTMLElement {
    const element = document.createElement("span");
    element.className = `pin ${kind}`;
    element.textContent = text;
    element.setAttribute("aria-hidden", "true");
    this.over.append(element);
    return element;
  }

  #mark(at: Vector3 | null): void {
    for (const element of this.#ring?.elements ?? []) element.remove();
    this.#ring = at && { at, elements: [this.#write("ring", ""), this.#write("ring", "")] };
  }

  #resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    const ratio = Math.min(devicePixelRatio, 2);
    this.#common.ratio.value = ratio;
    this.#renderer.setPixelRatio(ratio);
    this.#renderer.setSize(clientWidth, clientHeight, false);
    if (this.#isHome && this.#frame) this.home(true);
    this.#draw();
  }

  #moved(): void {
    this.#moving = performance.now();
    this.invalidate();
  }

  /** Requests a redraw in the next frame. */
  invalidate(): void {
    if (this.#asked !== 0) return;
    this.#askedAt = performance.now();
    this.#asked = requestAnimationFrame(() => this.#draw());
  }

  #panes(): Pane[] {
    const { clientWidth, clientHeight } = this.canvas;
    const has = (side: SideName): boolean => this.#sides[side].fine !== null || this.#sides[side].coarse !== null;
    return panes(this.#mode, clientWidth, clientHeight, this.#wipe, has);
  }

  #draw(): void {
    this.#asked = 0;
    // The time of the request counts, because a slow frame is drawn much later.
    const isMoving = this.#askedAt - this.#moving < REST;
    const now = performance.now();
    // Two consecutive requests of one movement: the time between their frames is the time to draw the first.
    if (isMoving && this.#askedAt - this.#last < 50) this.#slow ||= now - this.#last > SLOW;
    this.#last = now;
    const renderer = this.#renderer;
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    for (const { side, view, scissor } of this.#panes()) {
      if (scissor[2] <= 0) continue;
      const { fine, coarse, overlays, appearance, scene } = this.#sides[side];
      const useCoarse = coarse !== null && (fine === null || (isMoving && this.#slow));
      if (fine) fine.root.visible = !useCoarse;
      if (coarse) coarse.root.visible = useCoarse;
      if (appearance) appearance.visible = this.#hasColours;
      for (const { level, model } of overlays) model.root.visible = (level === "coarse") === useCoarse;
      const camera = this.#cameraControl.aim(view[2] / Math.max(1, view[3]));
      renderer.setViewport(...view);
      renderer.setScissor(...scissor);
      renderer.render(scene, camera);
      renderer.render(this.#aids, camera);
    }
    this.#place();
    clearTimeout(this.#resting);
    if (isMoving && this.#slow) this.#resting = setTimeout(() => this.invalidate(), 2 * REST);
    this.drawn?.();
  }

  /** Positions the labels over the canvas. */
  #place(): void {
    const [first, second] = this.#panes();
    if (!first) return;
    const put = (element: HTMLElement, at: Vector3, pane: Pane): void => {
      const seen = at.clone().project(this.#cameraControl.aim(pane.view[2] / Math.max(1, pane.view[3])));
      const x = pane.view[0] + ((seen.x + 1) / 2) * pane.view[2];
      const y = this.canvas.clientHeight - pane.view[1] - ((seen.y + 1) / 2) * pane.view[3];
      const inside = seen.z < 1 && Math.abs(seen.x) < 1.02 && Math.abs(seen.y) < 1.02;
      element.style.visibility = inside ? "visible" : "hidden";
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
    };
    if (this.#cross) {
      const [left, bottom, width, height] = first.view;
      const [x, y] = [left + width / 2, this.canvas.clientHeight - bottom - height / 2];
      this.#cross.style.transform = `translate(${x}px, ${y}px) translate(-50%, -50%)`;
    }
    const apart = second && second.view[0] + second.view[1] !== first.view[0] + first.view[1];
    for (const { elements, at } of [...this.#pins, ...this.#ruler.pins, ...(this.#ring ? [this.#ring] : [])]) {
      put(elements[0]!, at, first);
      if (!elements[1]) continue;
      if (apart) put(elements[1], at, second);
      else elements[1].style.visibility = "hidden";
    }
  }

  dispose(): void {
    cancelAnimationFrame(this.#asked);
    clearTimeout(this.#resting);
    this.#observer.disconnect();
    this.#cameraControl.dispose();
    for (const model of this.#models()) model.dispose();
    this.setSizes(null);
    this.setBuildVolume(null, true);
    this.#mark(null);
    for (const dots of this.#spots.values()) disposeOf(dots);
    for (const { appearance } of Object.values(this.#sides)) disposeOfAppearance(appearance);
    this.setRuler([], "");
    this.showCross(false);
    this.setShell(null);
    this.#renderer.dispose();
    this.#renderer.forceContextLoss();
  }
}
