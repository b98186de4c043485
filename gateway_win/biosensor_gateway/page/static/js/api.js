// Asks the server for something; a refusal is an Error whose message is the server's sentence.
// If it is a question, `question` has what can be chosen.

export async function ask(method, path, content) {
  const options = { method, headers: {} };
  if (method !== "GET") {
    options.headers["Content-Type"] = "application/json";
    options.body = JSON.stringify(content ?? {});
  }
  let response;
  try {
    response = await fetch(`/api/v1${path}`, options);
  } catch {
    throw new Error("The page's program does not answer. Has it been ended? Start it again.");
  }
  const isJson = (response.headers.get("content-type") ?? "").startsWith("application/json");
  const answer = isJson ? await response.json() : { problem: await response.text() };
  if (!response.ok) {
    const error = new Error(answer.problem ?? `The request was refused (${response.status}).`);
    if (answer.choices?.length) error.question = answer;
    throw error;
  }
  return answer;
}
