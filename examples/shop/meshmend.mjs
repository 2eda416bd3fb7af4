// Requests of the shop's backend to meshmend, with the shop's key.
import { createHash } from "node:crypto";
import { createWriteStream } from "node:fs";
import { mkdir, rename, rm } from "node:fs/promises";
import { basename, dirname } from "node:path";
import { Readable } from "node:stream";
import { pipeline } from "node:stream/promises";
import { settings } from "./settings.mjs";

async function ask(path, { json, ...init } = {}) {
  const headers = { authorization: `Bearer ${settings.key}` };
  if (json) headers["content-type"] = "application/json";
  const answer = await fetch(settings.meshmend + path, { ...init, headers, body: json && JSON.stringify(json) });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw Object.assign(new Error(problem.detail ?? `meshmend answered with ${answer.status}`), { status: answer.status, code: problem.code });
}

/** Makes a token that lets a page of this shop upload models of up to 100 MB for an hour. */
export async function browserToken() {
  const asked = { origin: settings.origin, max_bytes: 100_000_000, expires_in_s: 3600 };
  return (await ask("/v1/browser-tokens", { method: "POST", json: asked })).json();
}

/** Fetches a job with its quote, and with its report for the assumptions. */
export async function job(id) {
  return (await ask(`/v1/jobs/${encodeURIComponent(id)}?include=report`)).json();
}

/** Downloads a job's model to a file. The file exists only if its SHA-256 is correct. */
export async function download({ href, sha256 }, file) {
  const answer = await ask(href);
  const hash = createHash("sha256");
  const partial = `${file}.partial`;
  await mkdir(dirname(file), { recursive: true });
  try {
    const counted = async function* (bytes) {
      for await (const some of bytes) {
        hash.update(some);
        yield some;
      }
    };
    await pipeline(Readable.fromWeb(answer.body), counted, createWriteStream(partial));
    if (hash.digest("hex") !== sha256) throw new Error(`${basename(file)} arrived damaged`);
    await rename(partial, file);
  } finally {
    await rm(partial, { force: true });
  }
}
