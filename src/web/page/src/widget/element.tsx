import { render } from "preact";
import { Problem } from "meshmend-client";
import { DEFAULT_CHOICE } from "../report/alternatives";
import { type Unit, UNITS } from "../units";
import { type Language, firstSupported } from "../words/locale";
import type { MeshmendUploadElement, MeshmendUploadEventMap } from "./meshmend-upload";
import { ORIGIN } from "./origin";
import { Session, type ShopSettings } from "./session";
import { customerLocale } from "./texts";
import { type TokenSource, Tokens } from "./tokens";
import { Widget } from "./view";
import css from "./widget.css";

/** Shared by all elements. A constructed style sheet needs no `style-src` in the shop's Content-Security-Policy. */
const sheet = new CSSStyleSheet();
sheet.replaceSync(css);

/** `<meshmend-upload>`: the upload area for a shop's customers. docs/widget.md lists its attributes and events. */
export class MeshmendUpload extends HTMLElement implements MeshmendUploadElement {
  static readonly formAssociated = true;
  static readonly observedAttributes = ["lang", "accept", "display-unit", "token", "token-url"];

  /** The page may have set this property before the script loaded. */
  getToken = (this as { getToken?: TokenSource["getToken"] }).getToken ?? null;
  readonly #internals = this.attachInternals();
  readonly #root = this.attachShadow({ mode: "open" });
  readonly #tokens = new Tokens(() => ({ getToken: this.getToken, token: this.getAttribute("token"), tokenUrl: this.getAttribute("token-url") }));
  readonly #session = new Session(() => this.#settings(), this.#tokens, {
    send: (type, detail) => this.#send(type, detail),
    explain: (code, title) => this.#explain(code, title),
  });

  constructor() {
    super();
    this.#root.adoptedStyleSheets = [sheet];
    this.#session.state.listen(() => this.#internals.setFormValue(this.#formValue()));
  }

  get jobId(): string | null {
    return this.#session.state.value.job?.id ?? null;
  }

  get choice(): string {
    return this.#session.state.value.choice;
  }

  upload(file: File): void {
    this.#session.take(file);
  }

  reset(): void {
    this.#session.reset();
  }

  connectedCallback(): void {
    this.#draw();
    this.#session.wake();
  }

  disconnectedCallback(): void {
    // An element that only moves within the page is connected again before this runs.
    queueMicrotask(() => {
      if (!this.isConnected) this.#session.sleep();
    });
  }

  formResetCallback(): void {
    this.reset();
  }

  attributeChangedCallback(name: string): void {
    if (name.startsWith("token")) this.#tokens.forget();
    else if (this.isConnected) this.#draw();
  }

  /** The job's id under the element's name; with another result than the default also its id, under the name with `-choice`. */
  #formValue(): FormData | string | null {
    const [name, id] = [this.getAttribute("name"), this.jobId];
    if (!name || !id || this.choice === DEFAULT_CHOICE) return id;
    const value = new FormData();
    value.set(name, id);
    value.set(`${name}-choice`, this.choice);
    return value;
  }

  #draw(): void {
    const unit: Unit = UNITS.find((unit) => unit === this.getAttribute("display-unit")) ?? "mm";
    render(<Widget session={this.#session} language={this.#language()} unit={unit} accept={this.getAttribute("accept")} />, this.#root);
  }

  /** The language of the element or the page, if there are texts in it; else the browser's. */
  #language(): Language {
    const named = this.closest<HTMLElement>("[lang]")?.lang;
    return firstSupported(named ? [named, ...navigator.languages] : navigator.languages);
  }

  #settings(): ShopSettings {
    const maxBytes = this.getAttribute("max-bytes");
    const unit = this.getAttribute("unit");
    return {
      base: (this.getAttribute("server") ?? ORIGIN).replace(/\/+$/, ""),
      options: { ...this.#jsonAttribute("options"), ...(unit && { unit }), mode: "repair" },
      metadata: this.#jsonAttribute("metadata") as Record<string, string>,
      maxBytes: maxBytes === null ? Infinity : Number(maxBytes),
    };
  }

  #jsonAttribute(name: string): Record<string, unknown> {
    const text = this.getAttribute(name);
    if (!text) return {};
    try {
      const value: unknown = JSON.parse(text);
      if (typeof value === "object" && value !== null && !Array.isArray(value)) return value as Record<string, unknown>;
    } catch {
      // Invalid JSON; the error below covers it.
    }
    throw new Problem(0, "bad_attribute", "", `The attribute ${name} must be a JSON object: ${text}`);
  }

  #send<K extends keyof MeshmendUploadEventMap>(type: K, detail: MeshmendUploadEventMap[K]["detail"]): void {
    this.dispatchEvent(new CustomEvent(type, { detail, bubbles: true, composed: true }));
  }

  #explain(code: string, title: string): string {
    const { words } = customerLocale(this.#language());
    return words.advice[code] ?? (title || words.problem);
  }
}
