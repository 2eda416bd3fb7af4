import assert from "node:assert/strict";
import { createServer } from "node:http";
import { test } from "node:test";
import { type Job, Problem, fieldErrors } from "meshmend-client";
import { isRepair } from "../src/report/advice";
import { weightOf } from "../src/report/files";
import { fullReport } from "../src/state/job";

test("reads errors of a problem both as texts and as objects with fields", () => {
  assert.deepEqual(fieldErrors(["a", { field: "thickness", message: "b" }, { message: "c" }]), [
    { field: null, message: "a" },
    { field: "thickness", message: "b" },
    { field: null, message: "c" },
  ]);
  assert.deepEqual(fieldErrors(undefined), []);
  const body = JSON.stringify({ code: "invalid_options", errors: [{ field: "unit", message: "`unit` must be a unit." }] });
  assert.deepEqual(Problem.of(400, body, null).errors, [{ field: "unit", message: "`unit` must be a unit." }]);
});

test("the full report is a file of the job; older jobs contain their report", async () => {
  const service = createServer((request, response) => {
    const isThere = request.url === "/full";
    response.writeHead(isThere ? 200 : 404, { "content-type": "application/json" });
    response.end(JSON.stringify(isThere ? { mode: "repair", outcome: "whole" } : { code: "artifact_not_found" }));
  });
  await new Promise<void>((resolve) => service.listen(0, "127.0.0.1", resolve));
  const { port } = service.address() as { port: number };
  const server = { base: `http://127.0.0.1:${port}`, key: () => null };
  // The artifacts have no hash here.
  const { subtle } = globalThis.crypto;
  Object.defineProperty(globalThis.crypto, "subtle", { value: undefined, configurable: true });
  const job = (artifacts: object): Job => ({ id: "job_1", artifacts, report: { mode: "repair", outcome: "short" } }) as never;
  try {
    const outcome = async (artifacts: object): Promise<unknown> => ((await fullReport(server, job(artifacts))) as { outcome?: unknown }).outcome;
    assert.equal(await outcome({ "report-full.json": { href: "/full" } }), "whole");
    assert.equal(await outcome({ "report.json": { href: "/report" } }), "short");
    await assert.rejects(outcome({ "report-full.json": { href: "/nowhere" } }));
  } finally {
    Object.defineProperty(globalThis.crypto, "subtle", { value: subtle, configurable: true });
    service.close();
  }
});

test("a job without a mode is a repair, and files may have no size", () => {
  const job = (options: object): Parameters<typeof isRepair>[0] => ({ options, artifacts: { model: { bytes: 5 }, "after.png": {} } }) as never;
  assert.deepEqual([isRepair(job({})), isRepair(job({ mode: "repair" })), isRepair(job({ mode: "analyze" }))], [true, true, false]);
  assert.deepEqual(["model", "after.png", "none"].map((name) => weightOf(job({}), name)), [5, 0, 0]);
});
