// Serves the page and the widget from their sources, and passes all else on to a running service:
//   SERVICE=http://127.0.0.1:8080 PORT=8081 node dev.mjs
import { createServer, request } from "node:http";
import { bundle } from "./build.mjs";

const service = new URL(process.env.SERVICE ?? "http://127.0.0.1:8080");
const port = Number(process.env.PORT ?? 8081);
const types = { html: "text/html; charset=utf-8", js: "text/javascript; charset=utf-8", css: "text/css; charset=utf-8", svg: "image/svg+xml" };
let files = new Map();

const server = createServer(async (asked, answer) => {
  try {
    const path = new URL(asked.url, "http://page").pathname;
    const stable = { "/": "index.html", "/widget.js": "widget.js" }[path];
    if (stable) files = await bundle(false);
    const name = stable ?? (path.startsWith("/assets/") ? path.slice(8) : null);
    const bytes = name && files.get(name);
    if (bytes) {
      const headers = { "content-type": types[name.split(".").pop()], "cache-control": "no-store", "access-control-allow-origin": "*" };
      answer.writeHead(200, headers).end(bytes);
      return;
    }
    const headers = { ...asked.headers, host: service.host };
    // The page's own origin becomes the service's; a shop's stays, since its tokens are for that.
    if (headers.origin === `http://${asked.headers.host}`) headers.origin = service.origin;
    const onward = request({ host: service.hostname, port: service.port, path: asked.url, method: asked.method, headers }, (from) => {
      answer.writeHead(from.statusCode, from.headers);
      from.pipe(answer);
    });
    onward.on("error", () => answer.destroy());
    answer.on("close", () => onward.destroy());
    asked.pipe(onward);
  } catch (error) {
    answer.writeHead(500).end(String(error));
  }
});
server.listen(port, "127.0.0.1", () => console.log(`http://127.0.0.1:${port}`));
