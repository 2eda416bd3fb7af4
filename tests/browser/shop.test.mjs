// The backend of the demo shop, without a browser.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { mkdtempSync, readFileSync, readdirSync, rmSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { openShop } from "./support/shop.mjs";

const SHOP = new URL("../../examples/shop/", import.meta.url);
const { Webhook } = createRequire(new URL("server.mjs", SHOP))("standardwebhooks");

test("the shop accepts only messages that meshmend signed recently", { timeout: 60_000 }, async () => {
  const shop = await openShop();
  try {
    const text = JSON.stringify({ type: "ping", data: {} });
    const post = async (time, secret = shop.secret, sent = text) => {
      const signature = new Webhook(secret).sign("msg_1", new Date(time), text);
      const headers = { "webhook-id": "msg_1", "webhook-timestamp": String(Math.floor(time / 1000)), "webhook-signature": signature };
      return (await fetch(`${shop.url}/hooks/meshmend`, { method: "POST", headers, body: sent })).status;
    };
    assert.equal(await post(Date.now()), 204);
    assert.equal(await post(Date.now()), 204, "the same one again");
    assert.equal(await post(Date.now() - 3_600_000), 401, "an old one");
    assert.equal(await post(Date.now(), `whsec_${Buffer.alloc(24).toString("base64")}`), 401, "signed by somebody else");
    assert.equal(await post(Date.now(), shop.secret, text.replace("ping", "job.succeeded")), 401, "changed on its way");
    assert.equal((await fetch(`${shop.url}/hooks/meshmend`, { method: "POST", body: text })).status, 401, "not signed");
  } finally {
    await shop.stop();
  }
});

test("only pages of the shop may act for a customer", { timeout: 60_000 }, async () => {
  const shop = await openShop();
  try {
    const [cookie] = (await fetch(shop.url)).headers.getSetCookie()[0].split(";");
    const token = async (headers) => (await fetch(`${shop.url}/meshmend-token`, { method: "POST", headers })).status;
    assert.equal(await token({ cookie, origin: shop.url }), 201);
    assert.equal(await token({ cookie, origin: "https://evil.example" }), 403);
    assert.equal(await token({ origin: shop.url }), 403);
  } finally {
    await shop.stop();
  }
});

test("an ordered model is fetched once however many webhooks arrive, and a damaged one is rejected", async () => {
  const model = Buffer.from("a model");
  const figures = { printable: true, size_mm: [10, 10, 10], volume_mm3: 1000, area_mm2: 600, thinnest_wall_mm: 10 };
  const href = "/v1/jobs/job_1/artifacts/model";
  const report = { assumptions: [] };
  const job = { status: "succeeded", outcome: "repaired", quote: figures, report, artifacts: { model: { href, filename: "a-repaired.stl" } } };
  let downloads = 0;
  const service = createServer((request, response) => {
    assert.equal(request.headers.authorization, "Bearer key");
    const isModel = request.url === href;
    downloads += isModel;
    response.end(isModel ? model : JSON.stringify(job));
  });
  await new Promise((resolve) => service.listen(0, "127.0.0.1", resolve));
  const folder = mkdtempSync(join(tmpdir(), "meshmend-orders-"));
  const meshmend = `http://127.0.0.1:${service.address().port}`;
  Object.assign(process.env, { MESHMEND_URL: meshmend, MESHMEND_API_KEY: "key", MESHMEND_WEBHOOK_SECRET: "whsec_AAAA", SHOP_FOLDER: folder });
  const { find, order, quote, told } = await import(new URL("orders.mjs", SHOP));
  try {
    const refused = [
      { status: "failed" },
      { artifacts: { original: {} } },
      { quote: { ...figures, printable: false } },
      { quote: { ...figures, volume_mm3: null } },
      { quote: { ...figures, size_mm: [10, 10, 300] } },
      { quote: { ...figures, thinnest_wall_mm: 0.2 } },
    ];
    for (const change of refused) {
      const kept = { ...job };
      Object.assign(job, change);
      assert.ok((await quote("ann", "job_1")).refusal, JSON.stringify(change));
      Object.assign(job, kept);
    }
    const quoted = await quote("ann", "job_1");
    assert.equal(quoted.cents, 390 + 38 + 12);
    assert.equal(await order("bob", quoted.id), null, "a quote is its customer's own");
    const { id, status } = await order("ann", quoted.id);
    assert.equal(status, "received");
    const message = (sha256) => ({ type: "job.succeeded", data: { id: "job_1", printable: true, artifacts: { model: { href, sha256 } } } });
    await assert.rejects(told("msg_1", message("0".repeat(64))), /damaged/);
    assert.equal(find("ann", id).status, "received");
    const sound = message(createHash("sha256").update(model).digest("hex"));
    await Promise.all([told("msg_1", sound), told("msg_1", sound)]);
    await told("msg_1", sound);
    assert.deepEqual(find("ann", id), { id, status: "in production", cents: quoted.cents, file: "a-repaired.stl" });
    assert.equal(find("bob", id), null);
    assert.equal(downloads, 2, "the damaged one and the sound one");
    assert.deepEqual(readdirSync(join(folder, id)), ["a-repaired.stl"]);
    assert.deepEqual(readFileSync(join(folder, id, "a-repaired.stl")), model);
  } finally {
    service.closeAllConnections();
    service.close();
    rmSync(folder, { recursive: true, force: true });
  }
});
