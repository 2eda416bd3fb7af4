// The demo shop of examples/shop in front of a service that requires keys, each on its own origin.
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { run, serveFrom } from "./service.mjs";

const SHOP = new URL("../../../examples/shop/server.mjs", import.meta.url).pathname;
const SCOPES = "jobs:read,jobs:write,webhooks,tokens";

function freePort() {
  return new Promise((resolve, reject) => {
    const server = createServer().once("error", reject);
    server.listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });
}

/** Starts both, with a bucket if given; returns their URLs, requests with the shop's key, and a function that stops both. */
export async function openShop(bucket = null) {
  const data = mkdtempSync(join(tmpdir(), "meshmend-shop-"));
  const key = (await run("keys", "create", "--tenant", "shop", "--scopes", SCOPES, "--data-dir", data)).trim();
  const service = await serveFrom(data, "--auth", "keys", "--webhook-allow-private", ...(bucket?.args ?? []));
  const ask = async (path, init = {}) =>
    fetch(service.url + path, { ...init, headers: { ...init.headers, authorization: `Bearer ${key}` } });
  const port = await freePort();
  const url = `http://127.0.0.1:${port}`;
  const endpoint = { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ url: `${url}/hooks/meshmend` }) };
  const { secret } = await (await ask("/v1/webhook-endpoints", endpoint)).json();
  const folder = mkdtempSync(join(tmpdir(), "meshmend-orders-"));
  const env = {
    PATH: process.env.PATH,
    PORT: String(port),
    SHOP_FOLDER: folder,
    MESHMEND_URL: service.url,
    MESHMEND_BUCKET: bucket?.url ?? "",
    MESHMEND_API_KEY: key,
    MESHMEND_WEBHOOK_SECRET: secret,
  };
  const child = spawn(process.execPath, [SHOP], { stdio: ["ignore", "pipe", "inherit"], env });
  await new Promise((resolve, reject) => {
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`the shop ended with ${code}`)));
    child.stdout.once("data", resolve);
  });
  const stop = async () => {
    child.kill("SIGKILL");
    await service.stop();
    rmSync(folder, { recursive: true, force: true });
  };
  return { url, port, folder, secret, data, meshmend: service.url, ask, stop };
}
