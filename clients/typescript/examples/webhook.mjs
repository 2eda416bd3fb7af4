// Receives a webhook for each job that ends. The secret is in the answer that created the endpoint.
// For a callback_url, it is in `client.webhooks.secret()`.
import { createServer } from "node:http";
import { Webhook } from "standardwebhooks";

const webhook = new Webhook(process.env.WEBHOOK_SECRET);
const server = createServer(async (request, response) => {
  const body = Buffer.concat(await request.toArray());
  try {
    const message = webhook.verify(body.toString(), request.headers);
    console.log(message.type, message.data.id, message.data.outcome);
    response.writeHead(204).end();
  } catch {
    // Not from the service, or older than five minutes.
    response.writeHead(400).end();
  }
});
server.listen(Number(process.argv[2]), "127.0.0.1", () => console.log("listening on", server.address().port));
