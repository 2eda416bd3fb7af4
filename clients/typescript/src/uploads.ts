import { type Server, askJson } from "./http";
import { Problem } from "./problem";
import type { Upload } from "./shapes";

/** Announces a file and learns where to send it: straight to the bucket where there is one, else through the service. */
export function announce(server: Server, name: string, bytes: number, signal: AbortSignal): Promise<Upload> {
  return askJson(server, "/v1/uploads", { method: "POST", json: { name, bytes }, signal });
}

/**
 * Sends a file where `announce` said. One request, since a presigned one can't be sent in pieces: what is stopped begins anew, at the
 * same address. XMLHttpRequest, because fetch does not tell how much has gone.
 */
export function send(server: Server, upload: Upload, file: Blob, sent: (bytes: number) => void, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const { method, url, headers } = upload.put;
    const request = new XMLHttpRequest();
    request.open(method, url.startsWith("/") ? server.base + url : url);
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    const stop = (): void => request.abort();
    const settle = (end: () => void): void => {
      signal.removeEventListener("abort", stop);
      end();
    };
    request.upload.onprogress = (event) => sent(event.loaded);
    request.onload = () =>
      settle(() => {
        if (request.status >= 200 && request.status < 300) resolve();
        else reject(Problem.of(request.status, request.responseText, request.getResponseHeader("retry-after")));
      });
    request.onerror = () => settle(() => reject(Problem.unreachable()));
    request.onabort = () => settle(() => reject(signal.reason ?? new DOMException("stopped", "AbortError")));
    if (signal.aborted) return settle(() => reject(signal.reason));
    signal.addEventListener("abort", stop);
    request.send(file);
  });
}
