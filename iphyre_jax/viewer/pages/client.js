"use strict";
// Calls of the server. The page is at http://127.0.0.1:PORT/TOKEN/, so relative addresses include the token.

async function call(name, fields = {}) {
  const headers = { "Content-Type": "application/json" };
  let answer;
  try {
    answer = await fetch(`api/${name}`, { method: "POST", headers, body: JSON.stringify(fields) });
  } catch {
    throw new Error("the server does not answer; is iphyre-jax play still running?");
  }
  const value = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(value.error), { status: answer.status });
  return value;
}
