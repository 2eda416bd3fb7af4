// The built program on a free port with a temporary folder, and requests to it.
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const PROGRAM = process.env.MESHMEND_PROGRAM ?? new URL("../../../target/debug/meshmend", import.meta.url).pathname;
/** The longest time until the program listens, and until it has ended, in milliseconds. */
const START = 30_000;
const END = 10_000;

/** Starts a service; returns its URL and a function that stops it and removes its folder. */
export async function serve(...args) {
  return serveFrom(mkdtempSync(join(tmpdir(), "meshmend-page-")), ...args);
}

/** Starts a service on an existing folder. */
export async function serveFrom(folder, ...args) {
  const given = ["serve", "--listen", "127.0.0.1:0", "--data-dir", folder, "--blender", "/nonexistent", ...args];
  const child = spawn(PROGRAM, given, { stdio: ["ignore", "ignore", "pipe"], env: { PATH: process.env.PATH } });
  let log = "";
  const url = await new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error(`the service does not listen:\n${log}`)), START);
    child.once("error", reject);
    child.once("exit", (code) => reject(new Error(`the service ended with ${code}:\n${log}`)));
    child.stderr.on("data", (bytes) => {
      log += bytes;
      const [, address] = /listening on (http:\/\/[^\s,]+)/.exec(log) ?? [];
      if (address) (clearTimeout(timer), resolve(address));
    });
  }).catch((error) => {
    child.kill("SIGKILL");
    throw error;
  });
  const stop = async () => {
    const ended = new Promise((resolve) => child.once("exit", resolve));
    child.kill("SIGTERM");
    const timer = setTimeout(() => child.kill("SIGKILL"), END);
    await ended;
    clearTimeout(timer);
    rmSync(folder, { recursive: true, force: true });
  };
  return { url, stop };
}

/** Runs a command of the program, such as one that creates a key, and returns its output. */
export function run(...args) {
  return new Promise((resolve, reject) => {
    const child = spawn(PROGRAM, args, { stdio: ["ignore", "pipe", "inherit"], env: { PATH: process.env.PATH } });
    let out = "";
    child.stdout.on("data", (bytes) => (out += bytes));
    child.once("exit", (code) => (code === 0 ? resolve(out) : reject(new Error(`${args.join(" ")} ended with ${code}`))));
  });
}

/** Submits a file to the API, waits for the job's end, and returns the job with its report. */
export async function repaired(url, name, bytes, options = {}) {
  const form = new FormData();
  form.set("options", JSON.stringify(options));
  form.set("file", new Blob([bytes]), name);
  const { id } = await (await fetch(`${url}/v1/jobs`, { method: "POST", body: form })).json();
  let job;
  do {
    job = await (await fetch(`${url}/v1/jobs/${id}?include=report&wait=20`)).json();
  } while (!["succeeded", "failed", "canceled"].includes(job.status));
  return job;
}
