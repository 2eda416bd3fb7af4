import assert from "node:assert/strict";
import { test } from "node:test";
import { EventParser } from "meshmend-client";

const STREAM = 'event: progress\ndata: {"percent":1}\nid: 2\n\n: keep-alive\n\nevent: done\r\ndata: {"a":\r\ndata: 1}\r\n\r\n';

test("events do not depend on how the stream is split", () => {
  const whole = new EventParser().push(STREAM);
  assert.deepEqual(whole, [
    { name: "progress", data: '{"percent":1}' },
    { name: "done", data: '{"a":\n1}' },
  ]);
  for (let size = 1; size < 12; size += 1) {
    const parser = new EventParser();
    const pieces = STREAM.match(new RegExp(`[^]{1,${size}}`, "g"));
    assert.deepEqual(pieces.flatMap((piece) => parser.push(piece)), whole, `in pieces of ${size}`);
  }
});

test("an incomplete event is not reported", () => {
  assert.deepEqual(new EventParser().push("event: done\ndata: 1\n"), []);
});
