// A copy, because the view may start anywhere in a larger buffer, and floats must start at a multiple of four.
export const bytesOf = (view) => view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength);
