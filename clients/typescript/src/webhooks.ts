import { type Asked, type Server, ask, askJson, at, query } from "./http.js";
import { retryWithBackoff } from "./retry.js";
import type {
  NewWebhookEndpoint,
  WebhookDeliveries,
  WebhookDelivery,
  WebhookEndpoint,
  WebhookEndpointChange,
  WebhookEndpoints,
  WebhookSecret,
} from "./shapes.js";

/** The webhook endpoints and deliveries of the account. Requests that create something are not retried after a lost response. */
export class Webhooks {
  readonly #server: Server;
  readonly #within: number;

  constructor(server: Server, within: number) {
    this.#server = server;
    this.#within = within;
  }

  async list(): Promise<WebhookEndpoint[]> {
    return (await this.#ask<WebhookEndpoints>(at("/v1/webhook-endpoints"))).endpoints;
  }

  /** Creates an endpoint. Only this response contains the secret. */
  create(endpoint: NewWebhookEndpoint): Promise<WebhookEndpoint> {
    return this.#ask(at("/v1/webhook-endpoints"), { method: "POST", json: endpoint });
  }

  get(id: string): Promise<WebhookEndpoint> {
    return this.#ask(at("/v1/webhook-endpoints/{id}", { id }));
  }

  change(id: string, change: WebhookEndpointChange): Promise<WebhookEndpoint> {
    return this.#ask(at("/v1/webhook-endpoints/{id}", { id }), { method: "PATCH", json: change });
  }

  async delete(id: string): Promise<void> {
    const remove = () => ask(this.#server, at("/v1/webhook-endpoints/{id}", { id }), { method: "DELETE" });
    await retryWithBackoff(remove, { within: this.#within, repeatable: false });
  }

  /** Gives the endpoint a new secret. The old secret stays valid for a while. */
  rotate(id: string): Promise<WebhookEndpoint> {
    return this.#ask(at("/v1/webhook-endpoints/{id}/rotate", { id }), { method: "POST" });
  }

  /** Sends a test message to the endpoint. */
  test(id: string): Promise<WebhookDelivery> {
    return this.#ask(at("/v1/webhook-endpoints/{id}/test", { id }), { method: "POST" });
  }

  /** Returns the deliveries to an endpoint or for a job. */
  deliveries(of: { endpoint?: string; job?: string; cursor?: string; limit?: number } = {}): Promise<WebhookDeliveries> {
    const { endpoint, ...values } = of;
    const path = endpoint === undefined ? at("/v1/webhook-deliveries") : at("/v1/webhook-endpoints/{id}/deliveries", { id: endpoint });
    return this.#ask(query(path, values));
  }

  redeliver(id: string): Promise<WebhookDelivery> {
    return this.#ask(at("/v1/webhook-deliveries/{id}/redeliver", { id }), { method: "POST" });
  }

  /** Returns the secret that signs messages to a job's `callback_url`. */
  secret(): Promise<WebhookSecret> {
    return this.#ask(at("/v1/webhook-secret"));
  }

  rotateSecret(): Promise<WebhookSecret> {
    return this.#ask(at("/v1/webhook-secret/rotate"), { method: "POST" });
  }

  #ask<T>(path: string, asked: Asked = {}): Promise<T> {
    return retryWithBackoff(() => askJson<T>(this.#server, path, asked), { within: this.#within, repeatable: !asked.method });
  }
}
