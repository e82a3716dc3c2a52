// Asks the server. What it refuses becomes an Error with its words.

export async function get(path) {
  return answered(await fetch(path));
}

export async function post(path, content = {}) {
  return answered(await fetch(path, {
    method: "POST",
    headers: {"Content-Type": "application/json"},
    body: JSON.stringify(content),
  }));
}

async function answered(response) {
  if (response.ok) return response.json();
  const text = await response.text();
  let words = text;
  try {
    words = JSON.parse(text).error;
  } catch { /* plain text */ }
  throw new Error(words || `the server answered ${response.status}`);
}
