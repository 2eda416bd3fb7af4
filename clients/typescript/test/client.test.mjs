import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Client, DamagedDownload, JobFailed, Problem } from "meshmend-client";
import { fileAt, save } from "meshmend-client/node";
import { brokenRing, soundBox } from "../../../tests/browser/support/models.mjs";
import { run, serve, serveFrom } from "../../../tests/browser/support/service.mjs";
import { flaky } from "./flaky.mjs";

const isSubmission = (request) => request.method === "POST" && request.url === "/v1/jobs";
/** A model whose defect only a full read finds. */
const LATE_BREAK = Buffer.from("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n");
const QUICK = { pictures: false };

let service, client, folder;
before(async () => {
  service = await serve();
  client = new Client(service.url);
  folder = mkdtempSync(join(tmpdir(), "meshmend-client-"));
});
after(async () => {
  await service.stop();
  rmSync(folder, { recursive: true, force: true });
});

/** Processes to stop after the test. */
const begun = async (t, starting) => {
  const it = await starting;
  t.after(it.stop);
  return it;
};
const through = (t, ...given) => begun(t, flaky(...given));
const sha256 = (bytes) => createHash("sha256").update(bytes).digest("hex");
const all = async (pages) => {
  const found = [];
  for await (const it of pages) found.push(it);
  return found;
};
const refused = (work, status, code) =>
  assert.rejects(work, (error) => error instanceof Problem && error.status === status && error.code === code && error.detail.length > 0);

test("a broken model is repaired with progress, and the download matches its SHA-256", async () => {
  const heard = [];
  writeFileSync(join(folder, "ring.stl"), brokenRing());
  const file = await fileAt(join(folder, "ring.stl"));
  const job = await client.repair(file, { output: "obj" }, { onProgress: (it) => heard.push(it), metadata: { order: "7" } });
  assert.equal(job.outcome, "repaired");
  assert.equal(job.report.after.closed, true);
  assert.deepEqual([job.input.name, job.metadata], ["ring.stl", { order: "7" }]);
  assert.ok(heard.length > 0 && heard.every((it) => it.percent <= 100 && ["queued", "running"].includes(it.status)));
  const { sha256: expected, bytes } = job.artifacts.model;
  const model = await client.download(job);
  assert.deepEqual([sha256(model), model.length], [expected, bytes]);
  await save(client, job, join(folder, "ring.obj"));
  assert.equal(sha256(readFileSync(join(folder, "ring.obj"))), expected);
  assert.equal(JSON.parse(new TextDecoder().decode(await client.download(job, "report.json"))).outcome, "repaired");
  await assert.rejects(client.download(job, "none.png"), /has no file 'none.png'; it has .*model/);
  const other = { ...job, artifacts: { model: { ...job.artifacts.model, sha256: "0".repeat(64) } } };
  await assert.rejects(client.download(other), DamagedDownload);
  await assert.rejects(save(client, other, join(folder, "damaged.obj")), DamagedDownload);
  assert.deepEqual(readdirSync(folder).sort(), ["ring.obj", "ring.stl"]);
});

test("the same idempotency key creates one job, and another call a second", async () => {
  const how = { idempotencyKey: "order-1", name: "box.stl" };
  const [first, again] = [await client.submit(soundBox(), QUICK, how), await client.submit(soundBox(), QUICK, how)];
  assert.equal(again.id, first.id);
  assert.notEqual((await client.submit(soundBox(), QUICK, { name: "box.stl" })).id, first.id);
  await refused(client.submit(brokenRing(), QUICK, how), 422, "idempotency_key_reused");
});

test("a submission after a lost request, a 503 and a lost response creates one job", async (t) => {
  const proxy = await through(t, service.url, isSubmission, ["drop", 429, 503, "lose"]);
  const job = await new Client(proxy.url).repair(soundBox(), QUICK, { metadata: { is: "flaky" } });
  assert.equal(job.outcome, "already_printable");
  const pauses = proxy.seen.slice(1).map((it, i) => it.at - proxy.seen[i].at);
  assert.ok(pauses[1] >= 1_000 && pauses[2] >= 1_000, `what Retry-After says is waited for, not ${pauses}`);
  assert.equal(proxy.seen.length, 5);
  assert.equal(new Set(proxy.seen.map((it) => it.key)).size, 1);
  assert.equal((await all(client.list())).filter((it) => it.metadata.is === "flaky").length, 1);
});

test("retries end at the time limit", async (t) => {
  const proxy = await through(t, service.url, isSubmission, Array(100).fill(503));
  await refused(new Client(proxy.url, { timeout: 1_000 }).submit(soundBox()), 503, "unavailable");
  assert.equal(proxy.seen.length, 1);
  await proxy.stop();
  await assert.rejects(new Client(proxy.url, { timeout: 1_000 }).capabilities(), { code: "unreachable" });
});

const isStream = (request) => request.url.split("?")[0].endsWith("/events");

test("a broken event stream is resumed", async (t) => {
  const idle = await begun(t, serve("--no-workers"));
  const proxy = await through(t, idle.url, isStream, ["cut", "cut"]);
  const job = await new Client(proxy.url).submit(soundBox());
  const heard = [];
  for await (const event of new Client(proxy.url).events(job.id)) {
    heard.push(event.name === "done" ? event.job.status : event.progress.status);
    if (heard.length === 2) await new Client(idle.url).cancel(job.id);
  }
  assert.deepEqual(heard, ["queued", "queued", "canceled"]);
  assert.ok(proxy.seen.length > 1);
});

test("a job is polled if a proxy buffers the event stream", async (t) => {
  const idle = await begun(t, serve("--no-workers"));
  const proxy = await through(t, idle.url, isStream, Array(100).fill("drop"));
  const job = await new Client(proxy.url).submit(soundBox());
  setTimeout(() => void new Client(idle.url).cancel(job.id), 1_000);
  assert.equal((await new Client(proxy.url).wait(job.id, { timeout: 20_000 })).status, "canceled");
  assert.equal(proxy.seen.length, 1);
});

test("a rejected file throws a problem without a retry", async (t) => {
  const proxy = await through(t, service.url, isSubmission, []);
  await refused(new Client(proxy.url).repair(Buffer.from("no model at all"), {}, { name: "notes.txt" }), 415, "unsupported_model");
  await refused(client.repair(soundBox(), { preset: "none" }), 422, "invalid_options");
  assert.equal(proxy.seen.length, 1);
});

test("repair throws for a failed job, and wait returns the job", async () => {
  const failed = await client.repair(LATE_BREAK).catch((error) => error);
  assert.ok(failed instanceof JobFailed);
  assert.deepEqual([failed.job.problem.code, failed.job.problem.place], ["bad_input", { line: 6 }]);
  assert.equal((await client.wait(failed.job.id)).status, "failed");
});

test("several files are analysed in one job", async () => {
  const job = await client.analyze([new File([soundBox()], "box.stl"), new File([brokenRing()], "ring.stl")], QUICK);
  assert.equal(job.outcome, "not_printable");
  assert.deepEqual(job.report.files.map((file) => [file.name, file.printable]), [["box.stl", true], ["ring.stl", false]]);
});

test("an upload survives a lost response, and its model is converted", async (t) => {
  const proxy = await through(t, service.url, (request) => request.method === "PUT", ["drop", "lose"]);
  const lossy = new Client(proxy.url);
  const upload = await lossy.upload(soundBox(), { name: "box.stl" });
  const job = await client.wait(await lossy.submitFrom({ upload_id: upload.id }, QUICK));
  assert.deepEqual([job.status, job.input.name], ["succeeded", "box.stl"]);
  const again = await client.wait(await client.submitFrom({ job_id: job.id, file: "model" }, { ...QUICK, output: "off" }));
  assert.equal(new TextDecoder().decode(await client.download(again)).slice(0, 3), "OFF");
});

test("jobs are listed across pages and deleted", async () => {
  const made = [];
  for (let i = 0; i < 3; i += 1) made.push((await client.submit(soundBox(), QUICK)).id);
  for (const id of made) await client.wait(id);
  const found = (await all(client.list({ pageSize: 2, status: "succeeded" }))).map((job) => job.id);
  assert.ok(made.every((id) => found.includes(id)) && new Set(found).size === found.length);
  await client.delete(made[0]);
  await refused(client.get(made[0]), 410, "job_deleted");
});

test("a job is canceled by a call and after a timeout", async (t) => {
  const idle = await begun(t, serve("--no-workers"));
  const there = new Client(idle.url);
  const job = await there.submit(soundBox());
  assert.equal((await there.cancel(job.id)).status, "canceled");
  await assert.rejects(there.repair(soundBox(), {}, { timeout: 500 }), { name: "TimeoutError" });
  const stop = new AbortController();
  const events = [];
  const given = there.repair(soundBox(), {}, { signal: stop.signal, onProgress: (it) => (events.push(it), stop.abort(new Error("enough"))) });
  await assert.rejects(given, /enough/);
  assert.deepEqual((await all(there.list())).map((it) => it.status), ["canceled", "canceled", "canceled"]);
});

test("a missing or wrong key is rejected", async (t) => {
  const data = mkdtempSync(join(tmpdir(), "meshmend-client-keys-"));
  const key = (await run("keys", "create", "--data-dir", data)).trim().split("\n").at(-1);
  const locked = await begun(t, serveFrom(data, "--auth", "keys"));
  await refused(new Client(locked.url).capabilities(), 401, "unauthorized");
  await refused(new Client(locked.url, { key: "mm_wrong" }).repair(soundBox()), 401, "unauthorized");
  const mine = new Client(locked.url, { key: () => key });
  assert.equal((await mine.repair(soundBox(), QUICK)).outcome, "already_printable");
  const token = await mine.browserToken({ origin: "https://shop.example", max_bytes: 100_000 });
  assert.equal(token.origin, "https://shop.example");
  const made = await mine.webhooks.create({ url: "https://shop.example/hooks" });
  assert.match(made.secret, /^whsec_/);
  assert.equal((await mine.webhooks.change(made.id, { enabled: false })).enabled, false);
  assert.deepEqual((await mine.webhooks.list()).map((it) => it.id), [made.id]);
  assert.notEqual((await mine.webhooks.rotate(made.id)).secret, made.secret);
  assert.deepEqual((await mine.webhooks.deliveries({ endpoint: made.id })).deliveries, []);
  await mine.webhooks.delete(made.id);
  await refused(mine.webhooks.get(made.id), 404, "webhook_not_found");
});
