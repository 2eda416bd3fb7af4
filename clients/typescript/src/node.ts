// Functions for files on the disk, which need Node.
import { createHash } from "node:crypto";
import { openAsBlob } from "node:fs";
import { open, rename, rm } from "node:fs/promises";
import { basename } from "node:path";
import { type Call, type Client, artifactOf } from "./client.js";
import { ask } from "./http.js";
import { damaged } from "./jobs.js";
import { Problem } from "./problem.js";
import { retryWithBackoff } from "./retry.js";
import type { Job } from "./shapes.js";

/** Opens a file on the disk for sending. The file is read while it is sent, and again for each retry. */
export async function fileAt(path: string): Promise<File> {
  return new File([await openAsBlob(path)], basename(path));
}

/** Streams a file of a job to the disk and verifies its SHA-256. An error leaves no partial file. */
export async function save(client: Client, job: Job, path: string, name = "model", { timeout = 60_000, signal }: Call = {}): Promise<void> {
  const artifact = artifactOf(job, name);
  const part = `${path}.part`;
  const download = async (): Promise<void> => {
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
    await retryWithBackoff(download, { within: timeout, signal });
    await rename(part, path);
  } catch (error) {
    await rm(part, { force: true });
    throw error;
  }
}
