import assert from "node:assert/strict";
import { test } from "node:test";
import type { Job, Report } from "meshmend-client";
import { fileUnit, openSurfaceOf, sizeIn, withThickness, withUnit } from "../src/report/settings";
import { isScalable, scaledCopy } from "../src/state/scale";

function job(options: object, unit: object, more: object = {}): Job & { report: Report } {
  const report = { mode: "repair", outcome: "repaired", unit, input: { format: "stl" }, output: { format: "stl" }, before: { closed: true, print: { unit: "mm", size_mm: [10, 20, 30] } }, after: null, assumptions: [], ...more };
  return { options, report } as unknown as Job & { report: Report };
}

test("a result without a unit is converted from inches to millimetres", () => {
  const it = job({ mode: "repair", preset: "auto", unit: null }, { used: "mm", source: "assumed" });
  assert.deepEqual(sizeIn(it.report, "in"), [254, 508, 762]);
  assert.deepEqual(withUnit(it, it.report, "in"), { mode: "repair", preset: "auto", unit: "in", scale_to: "mm" });
  assert.deepEqual(withUnit(it, it.report, "mm"), { mode: "repair", preset: "auto", unit: "mm" });
});

test("a format with a unit keeps its numbers", () => {
  const it = job({}, { used: "mm", source: "file" }, { output: { format: "3mf" } });
  assert.deepEqual(withUnit(it, it.report, "cm"), { unit: "cm" });
});

test("the unit of a scaled file is the unit before scaling", () => {
  const it = job({ unit: "in", scale_to: "mm" }, { used: "mm", source: "declared", scaled_from: "in" });
  assert.equal(fileUnit(it.report), "in");
  assert.deepEqual(sizeIn(it.report, "in"), [10, 20, 30]);
});

test("lengths in options keep their value in millimetres", () => {
  const it = job({ thickness: 2 }, { used: "mm", source: "assumed" }, { output: { format: "glb" } });
  assert.deepEqual(withUnit(it, it.report, "cm"), { thickness: 0.2, unit: "cm" });
});

test("a thickness is sent in the model's unit, and a base stays a base", () => {
  const open = { outcome: "unrepairable", before: { closed: false, print: { unit: "in", size_mm: [1, 1, 1] } } };
  const it = job({ max_tier: 2 }, { used: "in", source: "declared" }, open);
  assert.deepEqual(openSurfaceOf(it), { is: "open", mm: null });
  assert.deepEqual(withThickness(it, it.report, 25.4), { max_tier: 2, open_sheets: "thicken", thickness: 1 });
  const base = job({}, { used: "mm", source: "assumed" }, { assumptions: [{ kind: "bases_added", count: 1, amount: 0.24, detail: "" }] });
  assert.deepEqual(openSurfaceOf(base), { is: "base", mm: 0.24 });
  assert.deepEqual(withThickness(base, base.report, 2), { open_sheets: "base", thickness: 2 });
  assert.equal(openSurfaceOf(job({}, { used: "mm", source: "assumed" })), null);
});

const text = async (file: File): Promise<string> => new TextDecoder().decode(await file.arrayBuffer());

test("a scaled copy multiplies all lengths in every format and keeps its name", async () => {
  const obj = await scaledCopy(new File(["v 1 2 -3 0.5 0.5 0.5\nvt 1 1\nvn 0 0 1\nf 1 1 1\n"], "a.obj"), "obj", 2);
  assert.equal(await text(obj), "v 2 4 -6 0.5 0.5 0.5\nvt 1 1\nvn 0 0 1\nf 1 1 1\n");
  assert.equal(obj.name, "a.obj");
  const ascii = await scaledCopy(new File(["solid a\nfacet normal 0 0 1\nouter loop\nvertex 1 0 1e1\n"], "a.stl"), "stl", 0.5);
  assert.equal(await text(ascii), "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0.5 0 5\n");
  const bytes = new DataView(new ArrayBuffer(134));
  bytes.setUint32(80, 1, true);
  for (let k = 0; k < 12; k += 1) bytes.setFloat32(84 + 4 * k, k, true);
  bytes.setUint16(132, 7, true);
  const binary = new DataView(await (await scaledCopy(new File([bytes.buffer], "a.stl"), "stl", 10)).arrayBuffer());
  assert.deepEqual(Array.from({ length: 12 }, (_, k) => binary.getFloat32(84 + 4 * k, true)), [0, 1, 2, 30, 40, 50, 60, 70, 80, 90, 100, 110]);
  assert.equal(binary.getUint16(132, true), 7);
  const gltf = JSON.parse(await text(await scaledCopy(new File([JSON.stringify({ scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }] })], "a.gltf"), "glb", 3)));
  assert.deepEqual(gltf, { scenes: [{ nodes: [1] }], nodes: [{ mesh: 0 }, { name: "scale", scale: [3, 3, 3], children: [0] }] });
  assert.deepEqual(["stl", "obj", "glb", "3mf", "ply"].map(isScalable), [true, true, true, false, false]);
});
