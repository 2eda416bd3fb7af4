// What needs Node: files on a disk.
import { createHash } from "node:crypto";
import { openAsBlob } from "node:fs";
import { open, rename, rm } from "node:fs/promises";
import { basename } from "node:path";
import { type Call, type Client, artifactOf } from "./client.js";
import { ask } from "./http.js";
import { damaged } from "./jobs.js";
import { Problem } from "./problem.js";
import { patiently } from "./retry.js";
import type { Job } from "./shapes.js";

/** A file on the disk, to be sent. It is read as it goes, and again where it must be sent again. */
export async function fileAt(path: string): Promise<File> {
  return new File([await openAsBlob(path)], basename(path));
}

/** Writes a file of a job to the disk as it comes. It is there whole and with the right hash, or not at all. */
export async function save(client: Client, job: Job, path: string, name = "model", { timeout = 60_000, signal }: Call = {}): Promise<void> {
  const artifact = artifactOf(job, name);
  const part = `${path}.part`;
  const fetched = async (): Promise<void> => {
    const answer = await ask(client, artifact.href, { signal });
    const hash = createHash("sha256");
    const file = await open(part, "w");
    try {
      const reader = answer.body!.getReader();
      for (;;) {
        const { done, value } = await reader.read().catch(() => {
          throw signal?.aborted ? signal.reason : Problem.unreachable();
        });
        if (done) break;
        hash.update(value);
        await file.writeFile(value);
      }
    } finally {
      await file.close();
    }
    if (artifact.sha256 && hash.digest("hex") !== artifact.sha256) throw damaged(artifact);
  };
  try {
    await patiently(fetched, { within: timeout, signal });
    await rename(part, path);
  } catch (error) {
    await rm(part, { force: true });
    throw error;
  }
}
