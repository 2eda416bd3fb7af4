import { useEffect, useState } from "preact/hooks";
import type { Capabilities } from "meshmend-client";
import { MOST_FILES, dropped } from "../state/files";
import { add, open, items, selected } from "../state/items";
import { usePageWords } from "../words/page-locale";
import { Dropzone } from "./dropzone";
import { FileList } from "./file-list";
import { FileView } from "./file-view";
import { useStore } from "./use-store";

/** The repair view: drop zone, list of files, and result. */
export function RepairPage({ job, can }: { job: string | null; can: Capabilities | null }) {
  const { words, figures } = usePageWords();
  const all = useStore(items);
  const chosen = useStore(selected);
  const [note, tell] = useState("");
  const [over, setOver] = useState(false);
  useEffect(() => {
    if (job) open(job);
  }, [job]);

  const take = (files: File[]): void => {
    const most = can?.limits.max_bytes ?? Infinity;
    const fine = files.slice(0, MOST_FILES).filter((file) => file.size <= most);
    const large = files.find((file) => file.size > most);
    if (files.length === 0) tell(words.noModels);
    else if (large) tell(words.tooLarge(large.name, figures.bytes(most)));
    else tell(files.length > MOST_FILES ? words.tooMany(MOST_FILES) : "");
    add(fine);
  };

  useEffect(() => {
    // A file dropped anywhere on the page is accepted; otherwise the browser would open it.
    let depth = 0;
    const carries = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
    const enter = (event: DragEvent): void => {
      if (!carries(event)) return;
      event.preventDefault();
      depth += event.type === "dragenter" ? 1 : event.type === "dragleave" ? -1 : 0;
      setOver(depth > 0);
    };
    const drop = (event: DragEvent): void => {
      if (!carries(event) || !event.dataTransfer) return;
      event.preventDefault();
      depth = 0;
      setOver(false);
      void dropped(event.dataTransfer, can?.input_formats ?? []).then(take);
    };
    addEventListener("dragenter", enter);
    addEventListener("dragleave", enter);
    addEventListener("dragover", enter);
    addEventListener("drop", drop);
    return () => {
      removeEventListener("dragenter", enter);
      removeEventListener("dragleave", enter);
      removeEventListener("dragover", enter);
      removeEventListener("drop", drop);
    };
  });

  const shown = all.find((item) => item.id === chosen);
  return (
    <>
      {over && all.length > 0 && <div class="letgo">{words.letGo}</div>}
      <p class="note" role="status">
        {note}
      </p>
      {all.length === 0 ? (
        <Dropzone can={can} over={over} take={take} />
      ) : (
        <div class={all.length > 1 ? "work several" : "work"}>
          <FileList items={all} chosen={chosen} take={take} can={can} />
          {shown && <FileView key={shown.id} item={shown} can={can} />}
        </div>
      )}
    </>
  );
}
