import { type Server, askJson, at } from "./http.js";
import { Problem } from "./problem.js";
import type { Upload } from "./shapes.js";

/** Creates an upload. Its `put` states where to send the file: to the bucket if the service uses one, else to the service. */
export function announce(server: Server, name: string, bytes: number, signal?: AbortSignal): Promise<Upload> {
  return askJson(server, at("/v1/uploads"), { method: "POST", json: { name, bytes }, signal });
}

/**
 * Sends the file of an upload in one request, since a presigned request cannot be split. A stopped upload starts again at the same URL.
 * `sent` receives the number of sent bytes if there is an XMLHttpRequest, since fetch reports no progress.
 */
export function send(server: Server, upload: Upload, file: Blob, sent: (bytes: number) => void, signal?: AbortSignal): Promise<void> {
  const { method, url, headers } = upload.put;
  const isOwn = url.startsWith("/");
  const address = isOwn ? server.base + url : url;
  const unreachable = (): Problem => Problem.unreachable(isOwn ? "service" : "store");
  if (typeof XMLHttpRequest === "undefined") {
    return sendByFetch(address, { method, headers, body: file, signal: signal ?? null }, unreachable);
  }
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open(method, address);
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    const stop = (): void => request.abort();
    const settle = (end: () => void): void => {
      signal?.removeEventListener("abort", stop);
      end();
    };
    request.upload.onprogress = (event) => sent(event.loaded);
    request.onload = () =>
      settle(() => {
        if (request.status >= 200 && request.status < 300) resolve();
        else reject(Problem.of(request.status, request.responseText, request.getResponseHeader("retry-after")));
      });
    request.onerror = () => settle(() => reject(unreachable()));
    request.onabort = () => settle(() => reject(signal?.reason ?? new DOMException("stopped", "AbortError")));
    if (signal?.aborted) return settle(() => reject(signal.reason));
    signal?.addEventListener("abort", stop);
    request.send(file);
  });
}

async function sendByFetch(address: string, init: RequestInit, unreachable: () => Problem): Promise<void> {
  const answer = await fetch(address, init).catch(() => {
    throw init.signal?.aborted ? init.signal.reason : unreachable();
  });
  if (!answer.ok) throw Problem.of(answer.status, await answer.text().catch(() => ""), answer.headers.get("retry-after"));
}
