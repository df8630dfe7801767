"""Page for account holders: log in, accept an invitation, change the password."""

from __future__ import annotations

import html
import json
import secrets

from app.server.login import page_policy, page_style
from app.server.shared_port import API

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: your account</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style nonce="{nonce}">{style}</style></head><body>
<form hidden id="login"><h1>ArtiWorld</h1>
<label>Name<input name="name" autocomplete="username" required autofocus></label>
<label>Password<input type="password" name="password" autocomplete="current-password" required>
</label><button>Log in</button><p role="alert"></p>{provider}</form>
<form hidden id="invitation"><h1>Welcome, <span></span></h1>
<label>Choose a password<input type="password" name="password" autocomplete="new-password"
 minlength="10" required></label><button>Begin</button><p role="alert"></p></form>
<form hidden id="account"><h1><span></span></h1>
<label>Password<input type="password" name="old" autocomplete="current-password" required></label>
<label>New password<input type="password" name="new" autocomplete="new-password" minlength="10"
 required></label><button>Change password</button>
<button type="button" id="logout">Log out</button><p role="alert"></p><a href="/">Back</a></form>
<script nonce="{nonce}">
const api = {api}, person = {person};
const ask = (path, body) => fetch(api + path, {{ method: "POST", cache: "no-store",
  headers: {{ "Content-Type": "application/json", "X-ArtiWorld": "1" }},
  body: JSON.stringify(body) }});
// The invitation stands behind the #, so that it is in no log of a server.
const code = new URLSearchParams(location.hash.slice(1)).get("invitation");
function show(id, title, path, extra, then) {{
  const form = document.getElementById(id), said = form.querySelector("p");
  form.hidden = false;
  if (title) form.querySelector("span").textContent = title;
  form.addEventListener("submit", async (event) => {{
    event.preventDefault();
    const answer = await ask(path, {{ ...Object.fromEntries(new FormData(form)), ...extra }});
    if (answer.ok) then(said); else said.textContent = (await answer.json()).error;
  }});
}}
const enter = () => location.replace("/");
if (code) ask("/invitation", {{ code }}).then(async (answer) => {{
  const heard = await answer.json();
  if (answer.ok) show("invitation", heard.name, "/invitation/accept", {{ code }}, enter);
  else {{ show("login", "", "/login", {{}}, enter);
    document.querySelector("#login p").textContent = heard.error; }}
}});
else if (person) show("account", person, "/password", {{}},
  (said) => {{ said.textContent = "Changed; you are logged out everywhere else."; }});
else show("login", "", "/login", {{}}, enter);
document.getElementById("logout").addEventListener("click", async () => {{
  await ask("/logout", {{}}); location.replace("/login"); }});
</script></body></html>
"""

_ANSWER = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: log in</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style nonce="{nonce}">{style}</style></head><body>
<form><h1>ArtiWorld</h1><p role="alert">{problem}</p><a class="button" href="{target}">Go on</a>
</form><script nonce="{nonce}">{wait}</script></body></html>
"""


def answer_page(problem: str = "") -> tuple[bytes, str]:
    """Return the page after a login with the provider, and its policy: it goes on by itself.

    A redirect wouldn't do: browsers keep strict cookies to themselves until a page of the same
    site leads on.

    Args:
        problem: why nobody is logged in, or "".
    """
    nonce = secrets.token_urlsafe(16)
    page = _ANSWER.format(
        nonce=nonce, style=page_style(), problem=html.escape(problem),
        target="/login" if problem else "/", wait="" if problem else "location.replace('/');",
    )  # fmt: skip
    return page.encode(), page_policy(nonce)


def account_page(name: str, provider: str = "") -> tuple[bytes, str]:
    """Return the page and its content security policy.

    Args:
        name: who is logged in, or "".
        provider: label of the button to the organisation's provider; "" for none.
    """
    nonce = secrets.token_urlsafe(16)
    person = json.dumps(name).replace("<", "\\u003c")
    link = f'<a class="button" href="{API}/oidc/login">{html.escape(provider)}</a>'
    page = _PAGE.format(
        nonce=nonce, style=page_style(), api=json.dumps(API), person=person,
        provider=link if provider else "",
    )  # fmt: skip
    return page.encode(), page_policy(nonce)
