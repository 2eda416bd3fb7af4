//! Repairs a model with a client that progenitor generates. Arguments: the service's URL, the model, the result's path.

use std::error::Error as StdError;

use futures::TryStreamExt;

progenitor::generate_api!(spec = "openapi-3.0.json", interface = Builder);

#[tokio::main]
async fn main() -> Result<(), Box<dyn StdError>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [address, input, output] = &arguments[..] else { return Err("three arguments are needed".into()) };
    let client = Client::new(address);
    let submit = client.submit_job().name("box.stl").output(types::OutputFormat::Stl).body(std::fs::read(input)?);
    let mut job = submit.send().await?.into_inner();
    while matches!(job.status, types::Status::Queued | types::Status::Running) {
        job = client.get_job().id(&job.id).wait(20).send().await?.into_inner();
    }
    println!("{} {}", job.status, job.outcome.ok_or("the job has no outcome")?);
    let model = client.get_artifact().id(&job.id).name("model").send().await?.into_inner();
    let pieces: Vec<_> = model.into_inner().try_collect().await?;
    std::fs::write(output, pieces.concat())?;
    Ok(())
}
