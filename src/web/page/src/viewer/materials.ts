import { Color, DoubleSide, ShaderMaterial, type Texture, Vector3, Vector4 } from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import type { Patch } from "./appearance/appearance";
import { type KindStyle, MARKS, PATTERNS } from "./kind-styles";

/** Uniforms that all materials of a viewer share: the cut, and the device pixels per CSS pixel. */
export interface Shared {
  /** Keeps points with `dot(p, xyz) <= w`. */
  cut: { value: Vector4 };
  ratio: { value: number };
}

export function shared(): Shared {
  return { cut: { value: new Vector4(0, 0, 0, 1) }, ratio: { value: 1 } };
}

/** The colour of back faces, visible through holes, at flipped faces and at the cut. */
const INSIDE = "#65313f";

/** Depth offsets toward the camera, as a share of the distance, so that overlays on a surface are visible. */
export const NEARER = { overlay: 0.0006, wire: 0.0008, dot: 0.004 };

const VERTEX = /* glsl */ `
uniform float nearer;
varying vec3 vWorld;
varying vec3 vView;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec4 view = viewMatrix * world;
  vWorld = world.xyz;
  vView = view.xyz;
  gl_Position = projectionMatrix * vec4(view.xyz * (1.0 - nearer), 1.0);
}`;

// Colours are mixed and written in sRGB. Face normals come from derivatives, so they need no memory.
const FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec3 inside;
uniform vec4 cut;
uniform float ratio;
uniform int pattern;
uniform bool shown;
uniform vec3 plain;
varying vec3 vWorld;
varying vec3 vView;

float marked(vec2 p) {
  if (pattern == 1) return step(0.5, fract((p.x + p.y) / 8.0));
  if (pattern == 2) return step(length(fract(p / 7.0) - 0.5), 0.27);
  if (pattern == 3) return max(step(0.78, fract((p.x + p.y) / 9.0)), step(0.78, fract((p.x - p.y) / 9.0)));
  if (pattern == 4) return step(0.55, fract(p.y / 6.0));
  if (pattern == 5) return mod(floor(p.x / 5.0) + floor(p.y / 5.0), 2.0);
  return 0.0;
}

void main() {
  if (dot(vWorld, cut.xyz) > cut.w) discard;
  vec3 normal = normalize(cross(dFdx(vView), dFdy(vView)));
  float key = max(dot(normal, vec3(0.32, 0.62, 0.72)), 0.0);
  float fill = max(dot(normal, vec3(-0.75, -0.1, 0.65)), 0.0);
  float light = 0.5 + 0.5 * key + 0.22 * fill;
  vec3 base = shown ? mix(colour, colour * 0.62, marked(gl_FragCoord.xy / ratio)) : plain;
  if (!gl_FrontFacing) {
    base = mix(inside, shown ? colour : inside, 0.25);
    light = 0.62 + 0.3 * light;
    if (cut.x != 0.0 || cut.y != 0.0 || cut.z != 0.0) base = mix(base, base * 1.25, step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / ratio / 9.0)));
  }
  gl_FragColor = vec4(min(base * light, vec3(1.0)), 1.0);
}`;

export function surfaceMaterial(colour: string, plain: string, look: KindStyle | null, isOverlay: boolean, common: Shared): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    side: DoubleSide,
    uniforms: {
      colour: { value: srgb(colour) },
      plain: { value: srgb(plain) },
      inside: { value: srgb(INSIDE) },
      pattern: { value: look ? PATTERNS.indexOf(look.pattern) : 0 },
      shown: { value: true },
      nearer: { value: isOverlay ? NEARER.overlay : 0 },
      cut: common.cut,
      ratio: common.ratio,
    },
  });
}

const APPEARANCE_VERTEX = /* glsl */ `
attribute vec3 tint;
attribute vec2 place;
varying vec3 vWorld;
varying vec3 vView;
varying vec3 vTint;
varying vec2 vPlace;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec4 view = viewMatrix * world;
  vWorld = world.xyz;
  vView = view.xyz;
  vTint = tint;
  vPlace = place;
  gl_Position = projectionMatrix * view;
}`;

// The lighting is that of the other surfaces, slightly brighter, so that colours look true.
const APPEARANCE_FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec4 cut;
uniform bool isTinted;
uniform bool hasPicture;
uniform sampler2D picture;
varying vec3 vWorld;
varying vec3 vView;
varying vec3 vTint;
varying vec2 vPlace;
void main() {
  if (dot(vWorld, cut.xyz) > cut.w) discard;
  vec3 normal = normalize(cross(dFdx(vView), dFdy(vView)));
  float key = max(dot(normal, vec3(0.32, 0.62, 0.72)), 0.0);
  float fill = max(dot(normal, vec3(-0.75, -0.1, 0.65)), 0.0);
  float light = 0.6 + 0.42 * key + 0.18 * fill;
  vec3 base = colour;
  if (isTinted) base *= vTint;
  if (hasPicture) base *= texture2D(picture, vPlace).rgb;
  if (!gl_FrontFacing) base *= 0.55;
  gl_FragColor = vec4(min(base * light, vec3(1.0)), 1.0);
}`;

/** Surface with its original colours and texture; plain without them. */
export function appearanceMaterial({ colours, colour }: Patch, picture: Texture | null, plain: string, common: Shared): ShaderMaterial {
  const isPlain = !colours && !picture && colour.every((part) => part >= 0.995);
  return new ShaderMaterial({
    vertexShader: APPEARANCE_VERTEX,
    fragmentShader: APPEARANCE_FRAGMENT,
    side: DoubleSide,
    uniforms: {
      colour: { value: isPlain ? srgb(plain) : new Vector3(...colour) },
      isTinted: { value: colours !== null },
      hasPicture: { value: picture !== null },
      picture: { value: picture },
      cut: common.cut,
    },
  });
}

const SHELL_FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec4 cut;
varying vec3 vWorld;
varying vec3 vView;
void main() {
  if (dot(vWorld, cut.xyz) > cut.w) discard;
  vec3 normal = normalize(cross(dFdx(vView), dFdy(vView)));
  float light = 0.55 + 0.5 * max(dot(normal, vec3(0.32, 0.62, 0.72)), 0.0);
  gl_FragColor = vec4(min(colour * light, vec3(1.0)), 0.82);
}`;

/** Surface of a preview: slightly transparent. */
export function shellMaterial(colour: string, common: Shared): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: SHELL_FRAGMENT,
    side: DoubleSide,
    transparent: true,
    uniforms: { colour: { value: srgb(colour) }, cut: common.cut, nearer: { value: 0.0003 } },
  });
}

const WIRE_FRAGMENT = /* glsl */ `
uniform vec4 cut;
uniform vec4 wire;
varying vec3 vWorld;
void main() {
  if (dot(vWorld, cut.xyz) > cut.w) discard;
  gl_FragColor = wire;
}`;

export function wireMaterial(common: Shared): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: WIRE_FRAGMENT,
    wireframe: true,
    transparent: true,
    depthWrite: false,
    uniforms: { cut: common.cut, nearer: { value: NEARER.wire }, wire: { value: new Vector4(0.05, 0.07, 0.1, 0.38) } },
  });
}

const DOT_VERTEX = /* glsl */ `
uniform float size;
uniform float ratio;
uniform float nearer;
varying vec3 vWorld;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vWorld = world.xyz;
  vec4 view = viewMatrix * world;
  gl_Position = projectionMatrix * vec4(view.xyz * (1.0 - nearer), 1.0);
  gl_PointSize = size * ratio;
}`;

const DOT_FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec4 cut;
uniform int mark;
varying vec3 vWorld;
float reach(vec2 p) {
  if (mark == 1) return max(abs(p.x), abs(p.y)) * 1.12;
  if (mark == 2) return abs(p.x) + abs(p.y);
  if (mark == 3) return max(abs(p.x) * 1.1 - p.y * 0.55, p.y + 0.12) * 1.12 + 0.1;
  return length(p);
}
void main() {
  if (dot(vWorld, cut.xyz) > cut.w) discard;
  float r = reach(gl_PointCoord * 2.0 - 1.0);
  if (r > 1.0) discard;
  gl_FragColor = vec4(r > 0.68 ? vec3(0.1) : colour, 1.0);
}`;

export function dotMaterial(colour: string, look: KindStyle, size: number, common: Shared): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: DOT_VERTEX,
    fragmentShader: DOT_FRAGMENT,
    uniforms: {
      colour: { value: srgb(colour) },
      size: { value: size },
      nearer: { value: NEARER.dot },
      mark: { value: MARKS.indexOf(look.mark) },
      cut: common.cut,
      ratio: common.ratio,
    },
  });
}

/** Lines with a width in pixels; a darker, wider line below forms the outline. */
export function lineMaterial(colour: string, width: number, dashed: boolean, dash: number): LineMaterial {
  const material = new LineMaterial({ color: 0xffffff, linewidth: width, dashed, dashSize: dash, gapSize: dash * 0.7 });
  material.color.copy(srgb(colour));
  material.polygonOffset = true;
  material.polygonOffsetFactor = -1;
  material.polygonOffsetUnits = -400;
  // The outline is drawn before its line and must not hide the line.
  material.depthWrite = false;
  return material;
}

/** A colour with sRGB components, which the shaders write unchanged. */
export function srgb(hex: string): Color {
  const number = Number.parseInt(hex.slice(1), 16);
  const colour = new Color();
  [colour.r, colour.g, colour.b] = [(number >> 16) / 255, ((number >> 8) & 255) / 255, (number & 255) / 255];
  return colour;
}
