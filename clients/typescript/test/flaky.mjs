// A proxy that injects the faults of networks and busy services.
import { createServer, request as ask } from "node:http";

/**
 * Each request that `hits` selects takes the next of `faults`: "drop" (the connection breaks), "lose" (the service gets the request, and its
 * response is lost), a status, or "cut" (the response breaks after its first piece). All other requests are forwarded.
 */
export async function flaky(url, hits, faults) {
  const left = [...faults];
  const seen = [];
  const server = createServer((request, response) => {
    const fault = hits(request) ? left.shift() : undefined;
    if (hits(request)) seen.push({ at: performance.now(), key: request.headers["idempotency-key"] });
    if (fault === "drop") return request.socket.destroy();
    if (typeof fault === "number") {
      request.resume();
      const body = JSON.stringify({ type: "", title: "busy", status: fault, detail: "busy", code: fault === 429 ? "queue_full" : "unavailable" });
      return response.writeHead(fault, { "content-type": "application/problem+json", "retry-after": "1" }).end(body);
    }
    const on = ask(new URL(request.url, url), { method: request.method, headers: request.headers }, (answer) => {
      if (fault === "lose") return request.socket.destroy();
      response.writeHead(answer.statusCode, answer.headers);
      answer.on("data", (piece) => {
        response.write(piece);
        if (fault === "cut") setTimeout(() => request.socket.destroy(), 20);
      });
      answer.on("end", () => response.end());
      answer.on("error", () => response.destroy());
    });
    on.on("error", () => response.destroy());
    response.on("close", () => on.destroy());
    request.pipe(on);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const stop = () => new Promise((resolve) => (server.closeAllConnections(), server.close(resolve)));
  return { url: `http://127.0.0.1:${server.address().port}`, seen, left, stop };
}
