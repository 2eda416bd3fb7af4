import assert from "node:assert/strict";
import { createServer } from "node:http";
import { test } from "node:test";
import { Problem, fieldErrors } from "meshmend-client";
import { isRepair } from "../src/report/advice";
import { weightOf } from "../src/report/files";
import { readJob } from "../src/state/job";

test("errors of a problem are texts or objects with fields, and both are read alike", () => {
  assert.deepEqual(fieldErrors(["a", { field: "thickness", message: "b" }, { message: "c" }]), [
    { field: null, message: "a" },
    { field: "thickness", message: "b" },
    { field: null, message: "c" },
  ]);
  assert.deepEqual(fieldErrors(undefined), []);
  const body = JSON.stringify({ code: "invalid_options", errors: [{ field: "unit", message: "`unit` must be a unit." }] });
  assert.deepEqual(Problem.of(400, body, null).errors, [{ field: "unit", message: "`unit` must be a unit." }]);
});

test("a job that carries no report is read with its file report.json, and one that carries it is taken as it is", async () => {
  const asked: string[] = [];
  const jobs: Record<string, object> = {
    "/v1/jobs/short": { status: "succeeded", artifacts: { "report.json": { href: "/report" } }, quote: {} },
    "/v1/jobs/whole": { status: "succeeded", artifacts: { "report.json": { href: "/report" } }, report: { mode: "repair", outcome: "here" } },
    "/v1/jobs/busy": { status: "running", artifacts: {} },
    "/v1/jobs/broken": { status: "succeeded", artifacts: { "report.json": { href: "/nowhere" } } },
    "/report": { mode: "repair", outcome: "fetched" },
  };
  const service = createServer((request, response) => {
    const path = request.url!.replace(/\?.*/, "");
    asked.push(path);
    response.writeHead(path in jobs ? 200 : 404, { "content-type": "application/json" }).end(JSON.stringify(jobs[path] ?? { code: "artifact_not_found" }));
  });
  await new Promise<void>((resolve) => service.listen(0, "127.0.0.1", resolve));
  const { port } = service.address() as { port: number };
  const server = { base: `http://127.0.0.1:${port}`, key: () => null };
  const { subtle } = globalThis.crypto;
  Object.defineProperty(globalThis.crypto, "subtle", { value: undefined, configurable: true });
  const { warn } = console;
  console.warn = () => undefined;
  try {
    const outcome = async (id: string): Promise<unknown> => ((await readJob(server, id)).report as { outcome?: unknown } | null)?.outcome;
    assert.equal(await outcome("short"), "fetched");
    assert.equal(await outcome("whole"), "here");
    assert.equal((await readJob(server, "busy")).report, undefined);
    assert.equal((await readJob(server, "broken")).status, "succeeded", "what else is known of it is shown");
    assert.equal(asked.filter((path) => path === "/report").length, 1);
  } finally {
    console.warn = warn;
    Object.defineProperty(globalThis.crypto, "subtle", { value: subtle, configurable: true });
    service.close();
  }
});

test("a job is a repair also where the service leaves out its mode, and files may have no size", () => {
  const job = (options: object): Parameters<typeof isRepair>[0] => ({ options, artifacts: { model: { bytes: 5 }, "after.png": {} } }) as never;
  assert.deepEqual([isRepair(job({})), isRepair(job({ mode: "repair" })), isRepair(job({ mode: "analyze" }))], [true, true, false]);
  assert.deepEqual(["model", "after.png", "none"].map((name) => weightOf(job({}), name)), [5, 0, 0]);
});
