"""Receives a webhook for each job that ends.

The secret is in the answer that created the endpoint. For a callback_url, it is in ``client.webhooks.secret()``.
"""

import os
import sys
from http.server import BaseHTTPRequestHandler, HTTPServer

from standardwebhooks import Webhook, WebhookVerificationError

webhook = Webhook(os.environ["WEBHOOK_SECRET"])


class Receiver(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        try:
            message = webhook.verify(body, {name.lower(): value for name, value in self.headers.items()})
            print(message["type"], message["data"]["id"], message["data"]["outcome"])
            self.send_response(204)
        except WebhookVerificationError:
            # Not from the service, or older than five minutes.
            self.send_response(400)
        self.end_headers()


server = HTTPServer(("127.0.0.1", int(sys.argv[1])), Receiver)
print("listening on", server.server_port)
server.serve_forever()
