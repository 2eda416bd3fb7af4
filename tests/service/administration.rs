//! Tenants and keys over the API, for keys with the scope `admin`.

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Api, Start};
use crate::support::access::{create_key, send, start_with_keys};

/// A client with a key that has the scope `admin`.
struct Admin {
    api: Api,
    admin: String,
}

impl Admin {
    async fn send(&self, method: Method, path: &str, body: Option<Value>) -> (u16, Value) {
        let request = self.api.http.request(method, format!("{}{path}", self.api.url)).bearer_auth(&self.admin);
        send(match body {
            Some(body) => request.json(&body),
            None => request,
        })
        .await
    }

    async fn get(&self, path: &str) -> Value {
        let (status, response) = self.send(Method::GET, path, None).await;
        assert_eq!(status, 200, "{path}: {response}");
        response
    }
}

#[tokio::test]
async fn a_key_shows_its_secret_once_and_is_invalid_after_it_is_revoked() {
    let data = tempfile::tempdir().expect("a folder");
    let admin = create_key(data.path(), "operator", "admin");
    let program = start_with_keys(Start::serve(data.path()));
    let admin = Admin { api: Api::new(&program), admin };
    let asked = json!({"tenant": "shop", "scopes": ["jobs:write", "jobs:read"], "label": "till", "expires_in_s": 3600});
    let request = admin.api.post("/v1/keys").bearer_auth(&admin.admin).json(&asked);
    let response = request.send().await.expect("a response");
    assert_eq!(
        (response.status().as_u16(), &response.headers()["cache-control"]),
        (201, &"no-store".parse().expect("text"))
    );
    let location = response.headers()["location"].to_str().expect("text").to_owned();
    let created: Value = response.json().await.expect("a key");
    let (id, secret) = (created["id"].as_str().expect("an id"), created["secret"].as_str().expect("a secret"));
    assert_eq!(location, format!("/v1/keys/{id}"));
    assert_eq!(created["scopes"], json!(["jobs:read", "jobs:write"]));
    assert!(created["expires_at"].is_string() && created["revoked_at"].is_null(), "{created}");
    let list = async |bearer: &str| send(admin.api.get("/v1/jobs").bearer_auth(bearer)).await.0;
    assert_eq!(list(secret).await, 200);
    assert_eq!(list(&admin.admin).await, 403, "the scope admin gives no access to jobs");

    let page = admin.get("/v1/keys?tenant=shop").await;
    assert_eq!((page["keys"][0]["id"].as_str(), &page["next"]), (Some(id), &Value::Null));
    assert!(!page.to_string().contains(secret) && !admin.get(&location).await.to_string().contains(secret));
    let first = admin.get("/v1/keys?limit=1").await;
    assert_eq!(first["keys"][0]["id"], created["id"], "newest first");
    let next = admin.get(&format!("/v1/keys?limit=1&cursor={}", first["next"].as_str().expect("a cursor"))).await;
    assert_eq!(next["keys"][0]["tenant"], "operator");

    for _ in 0..2 {
        assert_eq!(
            admin.send(Method::DELETE, &location, None).await.0,
            204,
            "the response is the same on a second request"
        );
    }
    assert_eq!(list(secret).await, 401);
    assert!(admin.get(&location).await["revoked_at"].is_string());
    let none = "/v1/keys/key_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a";
    for method in [Method::GET, Method::DELETE] {
        let (status, problem) = admin.send(method, none, None).await;
        assert_eq!((status, &problem["code"]), (404, &json!("key_not_found")));
    }
    assert!(!program.log().contains(&secret[7..]), "no secret is logged");
}

#[tokio::test]
async fn an_invalid_key_request_is_refused_with_the_name_of_the_field() {
    let data = tempfile::tempdir().expect("a folder");
    let admin = create_key(data.path(), "operator", "admin");
    let program = start_with_keys(Start::serve(data.path()));
    let admin = Admin { api: Api::new(&program), admin };
    for (asked, status, field) in [
        (json!({"tenant": "Not A Name"}), 422, "tenant"),
        (json!({"tenant": "shop", "expires_in_s": 1}), 422, "expires_in_s"),
        (json!({"tenant": "shop", "label": "two\nlines"}), 422, "label"),
        (json!({"tenant": "shop", "scopes": "jobs:read,tokens"}), 400, "jobs:read,tokens"),
        (json!({"scopes": []}), 400, "tenant"),
    ] {
        let (got, problem) = admin.send(Method::POST, "/v1/keys", Some(asked)).await;
        assert_eq!(got, status, "{problem}");
        assert!(problem["detail"].as_str().expect("text").contains(field), "{problem}");
    }
}

#[tokio::test]
async fn settings_of_a_tenant_are_changed_one_by_one_and_hold_at_once() {
    let data = tempfile::tempdir().expect("a folder");
    let admin = create_key(data.path(), "operator", "admin");
    let shop = create_key(data.path(), "shop", "jobs:read");
    let program = start_with_keys(Start::serve(data.path()));
    let admin = Admin { api: Api::new(&program), admin };
    let unset = json!({"id": "shop", "class": "standard", "max_queued": null, "max_running": null,
        "requests_per_minute": null});
    assert_eq!(admin.get("/v1/tenants/shop").await, unset);
    let change = async |body: Value| admin.send(Method::PATCH, "/v1/tenants/shop", Some(body)).await;
    let (status, _) = change(json!({"class": "gold", "max_queued": 5, "requests_per_minute": 1})).await;
    assert_eq!(status, 200);
    let (_, changed) = change(json!({"max_running": 2})).await;
    let all = json!({"id": "shop", "class": "gold", "max_queued": 5, "max_running": 2, "requests_per_minute": 1});
    assert_eq!(changed, all);
    let list = async || send(admin.api.get("/v1/jobs").bearer_auth(&shop)).await.0;
    assert_eq!((list().await, list().await), (200, 429));
    let (_, changed) = change(json!({"requests_per_minute": null, "class": null})).await;
    assert_eq!((&changed["requests_per_minute"], &changed["class"]), (&Value::Null, &json!("standard")));
    assert_eq!((&changed["max_queued"], list().await), (&json!(5), 200));
    for (body, field) in
        [(json!({"class": "Gold!"}), "class"), (json!({"requests_per_minute": 0}), "requests_per_minute")]
    {
        let (status, problem) = change(body).await;
        assert_eq!(status, 422);
        assert!(problem["detail"].as_str().expect("text").contains(field), "{problem}");
    }
    let names =
        |page: &Value| page["tenants"].as_array().expect("a list").iter().map(|tenant| tenant["id"].clone()).collect();
    let page = admin.get("/v1/tenants?limit=1").await;
    let first: Vec<Value> = names(&page);
    let page = admin.get(&format!("/v1/tenants?cursor={}", page["next"].as_str().expect("a cursor"))).await;
    let rest: Vec<Value> = names(&page);
    assert_eq!((first, rest), (vec![json!("operator")], vec![json!("shop")]));
    let (status, problem) = admin.send(Method::GET, "/v1/tenants/nobody", None).await;
    assert_eq!((status, &problem["code"]), (404, &json!("tenant_not_found")));
}

#[tokio::test]
async fn a_service_without_auth_still_requires_a_key_to_manage_keys() {
    let data = tempfile::tempdir().expect("a folder");
    let admin = create_key(data.path(), "operator", "admin");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let (status, problem) = send(api.post("/v1/keys").json(&json!({"tenant": "shop"}))).await;
    assert_eq!((status, &problem["code"]), (401, &json!("unauthorized")), "{problem}");
    assert_eq!(send(api.get("/v1/tenants")).await.0, 401);
    assert_eq!(send(api.get("/v1/tenants").bearer_auth(admin)).await.0, 200);
}
