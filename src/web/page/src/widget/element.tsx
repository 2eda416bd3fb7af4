import { render } from "preact";
import { Problem } from "meshmend-client";
import { type Unit, UNITS } from "../units";
import { type Language, firstSpoken } from "../words/words";
import type { MeshmendUploadElement, MeshmendUploadEventMap } from "./meshmend-upload";
import { ORIGIN } from "./origin";
import { Session, type Wishes } from "./session";
import { customerSpeech } from "./texts";
import { type TokenSource, Tokens } from "./tokens";
import { Widget } from "./view";
import css from "./widget.css";

/** Made once for all elements. As no element of the document, it needs no `style-src` of the shop. */
const sheet = new CSSStyleSheet();
sheet.replaceSync(css);

/** `<meshmend-upload>`: what a customer drops a model on. Its attributes and events are in docs/widget.md. */
export class MeshmendUpload extends HTMLElement implements MeshmendUploadElement {
  static readonly formAssociated = true;
  static readonly observedAttributes = ["lang", "accept", "display-unit", "token", "token-url"];

  /** It may have been set before the script came. */
  getToken = (this as { getToken?: TokenSource["getToken"] }).getToken ?? null;
  readonly #internals = this.attachInternals();
  readonly #root = this.attachShadow({ mode: "open" });
  readonly #tokens = new Tokens(() => ({ getToken: this.getToken, token: this.getAttribute("token"), tokenUrl: this.getAttribute("token-url") }));
  readonly #session = new Session(() => this.#wishes(), this.#tokens, {
    tell: (type, detail) => this.#tell(type, detail),
    explain: (code, title) => this.#explain(code, title),
  });

  constructor() {
    super();
    this.#root.adoptedStyleSheets = [sheet];
    this.#session.state.listen(() => this.#internals.setFormValue(this.jobId));
  }

  get jobId(): string | null {
    return this.#session.state.value.job?.id ?? null;
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
    // One that is only moved is connected again before this runs.
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

  #draw(): void {
    const unit: Unit = UNITS.find((it) => it === this.getAttribute("display-unit")) ?? "mm";
    render(<Widget session={this.#session} language={this.#language()} unit={unit} accept={this.getAttribute("accept")} />, this.#root);
  }

  /** Its own language or that of the page, where there are texts in it; else the browser's. */
  #language(): Language {
    const named = this.closest<HTMLElement>("[lang]")?.lang;
    return firstSpoken(named ? [named, ...navigator.languages] : navigator.languages);
  }

  #wishes(): Wishes {
    const most = this.getAttribute("max-bytes");
    const unit = this.getAttribute("unit");
    return {
      base: (this.getAttribute("server") ?? ORIGIN).replace(/\/+$/, ""),
      options: { ...this.#json("options"), ...(unit && { unit }), mode: "repair" },
      metadata: this.#json("metadata") as Record<string, string>,
      maxBytes: most === null ? Infinity : Number(most),
    };
  }

  #json(name: string): Record<string, unknown> {
    const text = this.getAttribute(name);
    if (!text) return {};
    try {
      const it: unknown = JSON.parse(text);
      if (typeof it === "object" && it !== null && !Array.isArray(it)) return it as Record<string, unknown>;
    } catch {
      // Said below.
    }
    throw new Problem(0, "bad_attribute", "", `The attribute ${name} must be a JSON object: ${text}`);
  }

  #tell<K extends keyof MeshmendUploadEventMap>(type: K, detail: MeshmendUploadEventMap[K]["detail"]): void {
    this.dispatchEvent(new CustomEvent(type, { detail, bubbles: true, composed: true }));
  }

  #explain(code: string, title: string): string {
    const { words } = customerSpeech(this.#language());
    return words.advice[code] ?? (title || words.problem);
  }
}
