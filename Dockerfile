# CPU only: `docker build -t stair_env .`, then `docker run --rm -v "$PWD/runs:/stair_env/runs" stair_env` (or `... stair_env make test`).
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends make g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /stair_env
COPY pyproject.toml constraints.txt Makefile README.md LICENSE ./
COPY stair_env stair_env
COPY stair_env_cli stair_env_cli
COPY perception perception
COPY policies policies
RUN make install PYTHON=python3.11
COPY . .
CMD ["make", "demo"]
