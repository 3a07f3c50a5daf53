import { bytesOf } from "../shared/bytes.js";

const KEPT_MS = 60000; // a browser that asks where to save reads the file only then

// Saves the files that the kernel sends as the browser saves downloads.
export function takeDownloads(model) {
  function save(content, buffers) {
    if (content.kind !== "download") return;
    const address = URL.createObjectURL(new Blob([bytesOf(buffers[0])])), link = document.createElement("a");
    Object.assign(link, { href: address, download: content.name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(address), KEPT_MS);
  }
  model.on("msg:custom", save);
  return () => model.off("msg:custom", save);
}
