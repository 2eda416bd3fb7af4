import { useState } from "preact/hooks";
import type { Problem } from "meshmend-client";
import { key, connect } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";
import { ProblemNote } from "./problem-note";

/** Asks for the API key of a service that requires one. */
export function AskForKey({ refused }: { refused: boolean }) {
  const { words } = usePageWords();
  const [text, set] = useState("");
  const send = (event: Event): void => {
    event.preventDefault();
    if (!text.trim()) return;
    key.set(text.trim());
    void connect();
  };
  return (
    <section class="gate card">
      <h1>
        <Icon name="key" size={22} /> {words.keyTitle}
      </h1>
      <p>{words.keyMore}</p>
      <form onSubmit={send}>
        <label for="key">{words.keyLabel}</label>
        <div class="row">
          <input id="key" type="password" autocomplete="off" spellcheck={false} value={text} aria-invalid={refused} aria-describedby={refused ? "key-wrong" : undefined} onInput={(event) => set(event.currentTarget.value)} />
          <button type="submit" class="primary">
            {words.keySend}
          </button>
        </div>
        <p id="key-wrong" class="wrong" role="alert">
          {refused ? words.keyWrong : ""}
        </p>
      </form>
    </section>
  );
}

export function Away({ problem }: { problem: Problem }) {
  const { words } = usePageWords();
  return (
    <section class="gate card">
      <h1>{words.away}</h1>
      <ProblemNote problem={problem} />
      <button type="button" class="primary" onClick={() => void connect()}>
        {words.retry}
      </button>
    </section>
  );
}
