import { type Server, askJson, at } from "./http.js";
import { Problem } from "./problem.js";
import type { Upload } from "./shapes.js";

/** Announces a file and learns where to send it: straight to the bucket where there is one, else through the service. */
export function announce(server: Server, name: string, bytes: number, signal?: AbortSignal): Promise<Upload> {
  return askJson(server, at("/v1/uploads"), { method: "POST", json: { name, bytes }, signal });
}

/**
 * Sends a file where `announce` said. One request, since a presigned one can't be sent in pieces: what is stopped begins anew, at the
 * same address. `sent` hears how much has gone where there is an XMLHttpRequest, since fetch does not tell.
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
