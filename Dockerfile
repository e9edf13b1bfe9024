# Run both commands of the README: docker build -t ssmr . && docker run --rm ssmr
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends git
WORKDIR /testbed
COPY . .
RUN python3 -m venv .venv && .venv/bin/pip install --no-cache-dir -e ".[test]"
ENV PATH=/testbed/.venv/bin:$PATH
CMD ["sh", "-c", "python -m validation.compare traj4 && python -m pytest"]
