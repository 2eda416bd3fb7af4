import { useRef, useState } from "preact/hooks";
import type { Job } from "meshmend-client";
import { key } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";
import { useStore } from "./use-store";

/** The address of a job's result on this page. It contains no key. */
export function linkTo(job: Job): string {
  return `${location.origin}${location.pathname}#/result/${job.id}`;
}

/** A link to the result to copy, and who can open it. */
export function Share({ job }: { job: Job }) {
  const { words, figures } = usePageWords();
  const secret = useStore(key);
  const field = useRef<HTMLInputElement>(null);
  const [note, setNote] = useState("");
  const copy = async (): Promise<void> => {
    try {
      await navigator.clipboard.writeText(linkTo(job));
      setNote(words.copied);
    } catch {
      // Pages served over plain HTTP have no access to this clipboard API.
      field.current?.focus();
      field.current?.select();
      setNote(document.execCommand("copy") ? words.copied : words.copyByHand);
    }
  };
  return (
    <section class="share">
      <h2>{words.share}</h2>
      <div class="row">
        <input ref={field} type="text" readOnly value={linkTo(job)} aria-label={words.shareLink} onFocus={(event) => event.currentTarget.select()} />
        <button type="button" class="plain" onClick={() => void copy()}>
          <Icon name="copy" /> {words.copy}
        </button>
      </div>
      <p class="aside" role="status">
        {note}
      </p>
      <p class="aside">
        {secret ? words.shareKey : words.shareOpen} {job.expires_at && words.shareUntil(figures.time(job.expires_at))}
      </p>
    </section>
  );
}
