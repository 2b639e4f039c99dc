// Reads an MCAP file with @mcap/core by its index: messages and a digest of their bytes by topic, as JSON.
import { createHash } from "node:crypto";
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const into = new Uint8Array(Number(length));
    const { bytesRead } = await file.read(into, 0, into.length, Number(offset));
    if (bytesRead !== into.length) throw new Error(`${bytesRead} bytes of ${into.length} at ${offset}`);
    return into;
  },
};
const decompressHandlers = { zstd: (packed, size) => decompress(packed, new Uint8Array(Number(size))) };
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const found = {};
for await (const { channelId, data, logTime } of reader.readMessages({ validateCrcs: true })) {
  const topic = reader.channelsById.get(channelId).topic;
  const own = (found[topic] ??= { count: 0, hash: createHash("sha256"), last_ns: "" });
  own.count += 1;
  own.hash.update(data);
  own.last_ns = String(logTime);
}
const topics = Object.fromEntries(
  Object.entries(found).map(([topic, own]) => [topic, { count: own.count, sha256: own.hash.digest("hex"), last_ns: own.last_ns }]),
);
const attachments = [];
for await (const attachment of reader.readAttachments()) attachments.push(attachment.name);
const told = Number(reader.statistics.messageCount);
console.log(JSON.stringify({ told, topics, attachments, schemas: [...reader.schemasById.values()].map((s) => s.name) }));
